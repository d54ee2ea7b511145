"""Plane of the ground through the last footholds, its unevenness and roughness.

With the place p_i, height z_i and slope g_i of the i-th last foothold, height h and slope g of the plane minimize

    Σ 2^-i (((z_i - h - g · (p_i - p_0)) / σ_z)² + |g_i - g|² / σ_g²)

A foot on a stone or an edge changes the plane less than two steps on a slope.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wbc_controller.records import Array
from wbc_controller.walking.quadruped_kernels import plane_below
from wbc_controller.walking.swing_kernels import TOUCHDOWN_SPEED

FOOTHOLDS = 4  # number of footholds of the plane
_HEIGHT, _SLOPE = 0.01, 0.1  # standard deviations of heights σ_z, m, and slopes σ_g of footholds from a plane
_KEPT = 0.8  # share of the unevenness kept per foothold
#: Additional touchdown speed per unevenness, 1/s, and largest speed, m/s: a slow foot lands late on lower ground.
_FASTER, _FASTEST = 20.0, 0.3
#: Largest error of a height on even ground, and least one on rough ground, m, and share of the roughness kept per
#: foothold.
_EVEN, _ROUGH, _REMEMBERED = 0.003, 0.007, 0.93
#: Distance of the planned touchdown below rough ground, m: the centre of pressure can wait after an early touchdown,
#: but the DCM moves away while a foot is late.
_BELOW = 0.02


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


class Roughness:
    """Memory of the errors of expected heights.

    Attributes:
        unevenness: largest error of the last footholds, m.
        share: roughness of the ground, from 0 (even) to 1.
    """

    STATE_FIELDS = ("unevenness", "share")

    def __init__(self) -> None:
        self.unevenness = self.share = 0.0

    def add(self, error: float, measures: bool) -> None:
        """Add the error of the height of a foothold, m; `measures`: it changes the roughness."""
        self.unevenness = max(error, _KEPT * self.unevenness)
        if measures:
            rough = max(0.0, min((error - _EVEN) / (_ROUGH - _EVEN), 1.0))
            self.share = max(rough, _REMEMBERED * self.share)

    @property
    def touchdown_speed(self) -> float:
        """Downward speed of the swing foot at touchdown, m/s."""
        return min(TOUCHDOWN_SPEED + _FASTER * self.unevenness, _FASTEST)


def aim_below(roughness: float) -> float:
    """Return the distance of the planned touchdown below ground of a roughness from 0 to 1, m."""
    return _BELOW * roughness
