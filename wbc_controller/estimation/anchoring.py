"""World frame fixed to the feet.

References in the drifting world of the filter would push a robot off its feet. Therefore the base is reported in a
frame F, in which points get an anchor aᵢ after `_CONTACT_TIME`. The transform from the filter's world, a rotation ψ
about the vertical and a translation t, follows

    min over ψ, t of  Σᵢ |R_z(ψ) dᵢ + t - aᵢ|²

with a time constant, without jumps.
"""

import math
from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.robot.orientation import heading_of, planar_transform
from wbc_controller.records import Array

_CONTACT_TIME = 1.0  # duration of a contact before its points get anchors, s
_TIME_CONSTANT = 0.2  # time constant of F, s
_PERIOD = 0.02  # time between two updates, s
_LEAST_SPREAD = 0.02  # smallest RMS distance of points from their mean for a heading, m


class Anchoring:
    """Transform from the filter's world to the frame F."""

    def __init__(self) -> None:
        self.transform = pin.SE3.Identity()
        self.due = self._updated = -np.inf  # time of the next update, and last one, s
        self._since: dict[str, float] = {}  # stamp of each contact's first update, s
        self._anchors: dict[str, Array] = {}

    def release(self, contact: str) -> None:
        """Delete the anchor of a contact that has ended or slipped."""
        self._since.pop(contact, None)
        self._anchors.pop(contact, None)

    def update(self, stamp: float, points: Mapping[str, Array]) -> None:
        """Fit the transform to the points dᵢ of the active contacts, (k, 3) in m in the filter's world; stamp in s."""
        elapsed = min(stamp - self._updated, _TIME_CONSTANT)
        self._updated, self.due = stamp, stamp + _PERIOD
        R, t = self.transform.rotation, self.transform.translation
        for name, positions in points.items():
            if name not in self._anchors and stamp - self._since.setdefault(name, stamp) >= _CONTACT_TIME:
                self._anchors[name] = positions @ R.T + t
        anchored = [name for name in points if name in self._anchors]
        if not anchored:
            return
        d, a = (np.vstack([of[name] for name in anchored]) for of in (points, self._anchors))
        d_mean, a_mean = d.mean(axis=0), a.mean(axis=0)
        gain, heading = elapsed / _TIME_CONSTANT, heading_of(self.transform)
        d_centred, a_centred = d - d_mean, a - a_mean
        if float(np.mean(d_centred[:, :2] ** 2)) >= _LEAST_SPREAD**2:
            sine = float(np.sum(d_centred[:, 0] * a_centred[:, 1] - d_centred[:, 1] * a_centred[:, 0]))
            fit = math.atan2(sine, float(np.sum(d_centred[:, :2] * a_centred[:, :2])))
            heading += gain * math.remainder(fit - heading, math.tau)
        # Rotate about the centroid of the feet: the origin of the filter's world may be far away.
        now = R @ d_mean + t
        self.transform = planar_transform(heading, d_mean, now + gain * (a_mean - now))
