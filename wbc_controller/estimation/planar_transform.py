"""Transforms between worlds with common vertical.

Worlds without absolute poses differ by such a transform, as heading and position are unobservable.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from wbc_controller.records import Array


class PlanarTransform(NamedTuple):
    """Transform x ↦ Rz(heading) x + translation, in rad and m."""

    heading: float
    translation: tuple[float, float, float]

    @property
    def rotation(self) -> Array:
        """Rz, (3, 3)."""
        c, s = math.cos(self.heading), math.sin(self.heading)
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    @property
    def pose(self) -> Array:
        """Position in m and quaternion x, y, z, w, (7,)."""
        return np.array([*self.translation, 0.0, 0.0, math.sin(0.5 * self.heading), math.cos(0.5 * self.heading)])

    def point(self, x: float, y: float, z: float) -> tuple[float, float, float]:
        """Transform a point."""
        c, s = math.cos(self.heading), math.sin(self.heading)
        tx, ty, tz = self.translation
        return c * x - s * y + tx, s * x + c * y + ty, z + tz

    def compose(self, first: PlanarTransform) -> PlanarTransform:
        """Return the transform that applies `first`, then this one."""
        return PlanarTransform(math.remainder(self.heading + first.heading, math.tau), self.point(*first.translation))

    def inverse(self) -> PlanarTransform:
        """Return the inverse transform."""
        x, y, z = PlanarTransform(-self.heading, (0.0, 0.0, 0.0)).point(*self.translation)
        return PlanarTransform(-self.heading, (-x, -y, -z))

    @staticmethod
    def mapping(x: Array, to: Array, heading: float) -> PlanarTransform:
        """Return the transform with a given heading that maps x to `to`."""
        a, b = PlanarTransform(heading, (0.0, 0.0, 0.0)).point(*x.tolist()), to.tolist()
        return PlanarTransform(heading, (b[0] - a[0], b[1] - a[1], b[2] - a[2]))


IDENTITY = PlanarTransform(0.0, (0.0, 0.0, 0.0))
