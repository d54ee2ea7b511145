"""Plane of the ground through the last footholds.

With the place p_i, height z_i and slope g_i of the i-th last foothold, height h and slope g of the plane minimize

    Σ 2^-i (((z_i - h - g · (p_i - p_0)) / σ_z)² + |g_i - g|² / σ_g²)

A foot on a stone or an edge changes the plane less than two steps on a slope.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wbc_controller.records import Array
from wbc_controller.walking.terrain_kernels import plane_below

FOOTHOLDS = 4  # number of footholds of the plane
_HEIGHT, _SLOPE = 0.01, 0.1  # standard deviations of heights σ_z, m, and slopes σ_g of footholds from a plane


@dataclass(slots=True)  # not frozen: faster construction
class Ground:
    """Plane of the ground."""

    place: complex  # of a point, x + i y in m
    height: float  # of this point, m
    slope: complex  # increase of the height along x and y, dz/dx + i dz/dy

    def height_at(self, place: complex) -> float:
        """Return the height at a place, m."""
        to = place - self.place
        return self.height + self.slope.real * to.real + self.slope.imag * to.imag

    @classmethod
    def below(cls, points: Array) -> "Ground":
        """Return the plane with the smallest squared vertical distances to points, (n, 3), not on a line."""
        return cls(*plane_below(points))


def plane_through(footholds: Sequence[Ground]) -> Ground:
    """Return the plane through footholds, the last one first."""
    last = footholds[0].place
    n = x = y = xx = xy = yy = z = xz = yz = 0.0  # weighted sums
    for age, each in enumerate(footholds):
        to, of_height, of_slope = each.place - last, 0.5**age / _HEIGHT**2, 0.5**age / _SLOPE**2
        n, x, y = n + of_height, x + of_height * to.real, y + of_height * to.imag
        xx = xx + of_height * (to.real * to.real) + of_slope
        xy = xy + of_height * (to.real * to.imag)
        yy = yy + of_height * (to.imag * to.imag) + of_slope
        z = z + of_height * each.height
        xz = xz + of_height * each.height * to.real + of_slope * each.slope.real
        yz = yz + of_height * each.height * to.imag + of_slope * each.slope.imag
    solution = np.linalg.solve([[n, x, y], [x, xx, xy], [y, xy, yy]], [z, xz, yz])
    height, along_x, along_y = solution.tolist()
    return Ground(last, height, complex(along_x, along_y))
