"""A frame that lives with the feet: where nothing observes position and heading, references stay where the feet are.

The filter's world drifts: its position and its heading, together with all contact points, as nothing observes them.
References that are given in that world would push a robot off its own feet. So the base is reported in a frame F that
is kept on them: points that have held for a while have an anchor aᵢ in F, and the motion from the filter's world to F,
a turn by ψ about the vertical and a translation t, follows the one that fits best,

    min over ψ, t of  Σᵢ |R_z(ψ) dᵢ + t - aᵢ|²

with a time constant, so that it never jumps: not when a contact begins or ends, and not when one that has slipped gets
a new anchor. A robot that walks holds no contact for that long, and F then drifts with the filter's world.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from wbc_controller.estimation.frame_transform import HERE, Move
from wbc_controller.records import Array

#: Time for which a contact has held before its points get anchors, s: longer than a step, and until they have settled.
_HELD = 1.0
#: Time constant with which the frame follows, s: longer than the noise of the points lasts.
_FOLLOWS = 0.2
#: Time between two looks at the points, s: drift is slow.
_EVERY = 0.02
#: Smallest distance between points, as RMS from their mean, that tells their heading, m.
_APART = 0.02


class Anchoring:
    """The motion from the filter's world to the frame that lives with the feet.

    Attributes:
        move: the turn by ψ about the vertical, and the translation t.
    """

    def __init__(self) -> None:
        self.move = HERE
        self._due = self._looked = -np.inf
        self._since: dict[str, float] = {}  # stamp at which each contact was first seen to hold, s
        self._anchors: dict[str, Array] = {}

    def release(self, contact: str) -> None:
        """Forget the anchor of a contact that has ended or slipped."""
        self._since.pop(contact, None)
        self._anchors.pop(contact, None)

    def due(self, stamp: float) -> bool:
        """Whether it is time to look at the points again."""
        return stamp >= self._due

    def follow(self, stamp: float, points: Mapping[str, Array]) -> None:
        """Follow the points of the contacts that hold.

        Args:
            stamp: of the estimate, s.
            points: dᵢ of each of these contacts in the filter's world, (k, 3) in m.
        """
        elapsed = min(stamp - self._looked, _FOLLOWS)
        self._looked, self._due = stamp, stamp + _EVERY
        R, t = self.move.rotation, np.array(self.move.shift)
        for name, places in points.items():
            if name not in self._anchors and stamp - self._since.setdefault(name, stamp) >= _HELD:
                self._anchors[name] = places @ R.T + t
        held = [name for name in points if name in self._anchors]
        if not held:
            return
        d, a = (np.vstack([of[name] for name in held]) for of in (points, self._anchors))
        middle, wanted = d.mean(axis=0), a.mean(axis=0)
        share, turn = elapsed / _FOLLOWS, self.move.turn
        seen, kept = d - middle, a - wanted
        if float(np.mean(seen[:, :2] ** 2)) >= _APART**2:
            across = float(np.sum(seen[:, 0] * kept[:, 1] - seen[:, 1] * kept[:, 0]))
            fit = math.atan2(across, float(np.sum(seen[:, :2] * kept[:, :2])))
            turn += share * math.remainder(fit - turn, math.tau)
        # It turns about the middle of the feet, not about the far origin of the filter's world.
        now = R @ middle + t
        self.move = Move.taking(middle, now + share * (wanted - now), turn)
