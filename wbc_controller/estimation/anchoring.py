"""A world frame that stays on the feet, for robots whose position and heading are unobservable.

The filter's world drifts: its position and heading are unobservable, and all contact points drift with it. References
in that world would push a robot off its own feet. Therefore the base is reported in a frame F that stays on the feet:
points that have been in contact for a while have an anchor aᵢ in F, and the transform from the filter's world to F, a
rotation by ψ about the vertical and a translation t, follows the best fit,

    min over ψ, t of  Σᵢ |R_z(ψ) dᵢ + t - aᵢ|²

with a time constant, so that it never jumps: neither at touchdown or lift-off, nor when a contact gets a new anchor
after a slip. A walking robot holds no contact for that long, and F then drifts with the filter's world.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from wbc_controller.estimation.planar_transform import IDENTITY, PlanarTransform
from wbc_controller.records import Array

#: Duration of a contact before its points get anchors, s: longer than a step and than their settling.
_HELD = 1.0
#: Time constant of the frame, s: longer than the noise of the points.
_FOLLOWS = 0.2
#: Time between two updates, s: drift is slow.
_PERIOD = 0.02
#: Smallest RMS distance of the points from their mean that determines a heading, m.
_APART = 0.02


class Anchoring:
    """The transform from the filter's world to the frame on the feet.

    Attributes:
        transform: the rotation by ψ about the vertical, and the translation t.
    """

    def __init__(self) -> None:
        self.transform = IDENTITY
        self._due = self._updated = -np.inf
        self._since: dict[str, float] = {}  # stamp of each contact's first update, s
        self._anchors: dict[str, Array] = {}

    def release(self, contact: str) -> None:
        """Forget the anchor of a contact that has ended or slipped."""
        self._since.pop(contact, None)
        self._anchors.pop(contact, None)

    def due(self, stamp: float) -> bool:
        """Return whether the next update is due."""
        return stamp >= self._due

    def follow(self, stamp: float, points: Mapping[str, Array]) -> None:
        """Follow the points of the active contacts.

        Args:
            stamp: of the estimate, s.
            points: dᵢ of each contact in the filter's world, (k, 3) in m.
        """
        elapsed = min(stamp - self._updated, _FOLLOWS)
        self._updated, self._due = stamp, stamp + _PERIOD
        R, t = self.transform.rotation, np.array(self.transform.translation)
        for name, places in points.items():
            if name not in self._anchors and stamp - self._since.setdefault(name, stamp) >= _HELD:
                self._anchors[name] = places @ R.T + t
        held = [name for name in points if name in self._anchors]
        if not held:
            return
        d, a = (np.vstack([of[name] for name in held]) for of in (points, self._anchors))
        d_mean, a_mean = d.mean(axis=0), a.mean(axis=0)
        gain, heading = elapsed / _FOLLOWS, self.transform.heading
        d_centred, a_centred = d - d_mean, a - a_mean
        if float(np.mean(d_centred[:, :2] ** 2)) >= _APART**2:
            sine = float(np.sum(d_centred[:, 0] * a_centred[:, 1] - d_centred[:, 1] * a_centred[:, 0]))
            fit = math.atan2(sine, float(np.sum(d_centred[:, :2] * a_centred[:, :2])))
            heading += gain * math.remainder(fit - heading, math.tau)
        # The rotation is about the middle of the feet, not about the distant origin of the filter's world.
        now = R @ d_mean + t
        self.transform = PlanarTransform.mapping(d_mean, now + gain * (a_mean - now), heading)
