"""Motions between worlds that share their vertical, as nothing observes heading and position."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from wbc_controller.records import Array


class Move(NamedTuple):
    """A motion of the world that keeps its vertical: x ↦ Rz(turn) x + shift, in rad and m."""

    turn: float
    shift: tuple[float, float, float]

    @property
    def rotation(self) -> Array:
        """Rz, (3, 3)."""
        c, s = math.cos(self.turn), math.sin(self.turn)
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    @property
    def pose(self) -> Array:
        """As a pose: position in m and quaternion x, y, z, w, (7,)."""
        return np.array([*self.shift, 0.0, 0.0, math.sin(0.5 * self.turn), math.cos(0.5 * self.turn)])

    def of(self, x: float, y: float, z: float) -> tuple[float, float, float]:
        """Where a point comes to."""
        c, s = math.cos(self.turn), math.sin(self.turn)
        return c * x - s * y + self.shift[0], s * x + c * y + self.shift[1], z + self.shift[2]

    def after(self, first: Move) -> Move:
        """The motion that makes another one first."""
        return Move(math.remainder(self.turn + first.turn, math.tau), self.of(*first.shift))

    def back(self) -> Move:
        """The inverse."""
        x, y, z = Move(-self.turn, (0.0, 0.0, 0.0)).of(*self.shift)
        return Move(-self.turn, (-x, -y, -z))

    @staticmethod
    def taking(x: Array, to: Array, turn: float) -> Move:
        """The motion that turns, and takes a point to another."""
        a, b = Move(turn, (0.0, 0.0, 0.0)).of(*x.tolist()), to.tolist()
        return Move(turn, (b[0] - a[0], b[1] - a[1], b[2] - a[2]))


#: From a world to itself.
HERE = Move(0.0, (0.0, 0.0, 0.0))
