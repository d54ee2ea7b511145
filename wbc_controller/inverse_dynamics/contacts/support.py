"""Support polygons, friction and wrench cones."""

import itertools
import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from wbc_controller.errors import ConfigurationError
from wbc_controller.records import Array

_SAME_FACET = 1.0e-7  # difference of cone facets, for a polygon of size 1
_CORNER = 1.0e-6  # distance of a vertex from the hull of the others, relative to the polygon's size


def friction_pyramid(friction: float) -> Array:
    """Return a pyramid C, (8, 3), inside the friction cone: C f ≤ 0 implies √(fx² + fy²) ≤ friction fz.

    At least cos(π / 8) = 92 % of the friction is available.
    """
    sides = 8
    normal = 2.0 * math.pi * (np.arange(sides) + 0.5) / sides
    reach = friction * math.cos(math.pi / sides)
    return np.column_stack([np.cos(normal), np.sin(normal), np.full(sides, -reach)])


def wrench_cone(friction: float, half_length: float, half_width: float) -> Array:
    """Return the exact wrench cone of a rectangle with pyramids |fx|, |fy| ≤ friction fz at its corners.

    A wrench w = [fx, fy, fz, τx, τy, τz] about the centre is feasible if C w ≤ 0, with C (16, 6).

    Source: Caron, Pham, Nakamura, "Stability of surface contacts for humanoid robots" (ICRA 2015).
    """
    mu, x, y = friction, half_length, half_width
    rows = []
    for sign in (1.0, -1.0):
        rows.append([sign, 0, -mu, 0, 0, 0])  # sliding along x
        rows.append([0, sign, -mu, 0, 0, 0])  # sliding along y
        rows.append([0, 0, -y, sign, 0, 0])  # centre of pressure along y
        rows.append([0, 0, -x, 0, sign, 0])  # centre of pressure along x
    # Yaw: τz ≥ -μ(X+Y)fz + |Y fx - μ τx| + |X fy - μ τy|, and τz ≤ μ(X+Y)fz - |Y fx + μ τx| - |X fy + μ τy|.
    for a, b in itertools.product((1.0, -1.0), repeat=2):
        rows.append([a * y, b * x, -mu * (x + y), -a * mu, -b * mu, -1.0])
        rows.append([a * y, b * x, -mu * (x + y), a * mu, b * mu, 1.0])
    return np.array(rows, dtype=np.float64)


def polygon_wrench_cone(friction: float, vertices: Array) -> Array:
    """Return the exact wrench cone C, (rows, 6), of a convex polygon with vertices (n, 2), as in `wrench_cone`.

    Forces along the four pyramid edges at each vertex span the cone. Scaled to fz = 1, they are the corners of a
    polytope in (fx, fy, τx, τy, τz); its facets are the rows of C (Caron, Pham, Nakamura, RSS 2015). Rows are scaled to
    a yaw coefficient of size 1; if it is 0, to those of τx and τy, then of fx and fy.
    """
    middle = vertices.mean(axis=0)
    size = float(np.abs(vertices - middle).max())
    corners = (vertices - middle) / size
    rays = np.array([[fx, fy, y, -x, x * fy - y * fx] for x, y in corners for fx in (1, -1) for fy in (1, -1)])
    simplices = ConvexHull(rays).equations  # (k, 6): a p + b ≤ 0, several simplices per facet
    _, first = np.unique(np.round(simplices / _SAME_FACET), axis=0, return_index=True)
    facets = simplices[np.sort(first)]
    facets[np.abs(facets) < 1.0e-12] = 0.0
    # Undo the normalization.
    C = facets[:, [0, 1, 5, 2, 3, 4]] / np.array([friction, friction, 1.0, size, size, friction * size])
    # Moments about the origin: τ about the middle m is τ - m × f.
    mx, my = middle
    C[:, :3] += C[:, 3:] @ np.array([[0.0, 0.0, -my], [0.0, 0.0, mx], [my, -mx, 0.0]])
    yaw, tilt, slide = np.abs(C[:, 5]), np.hypot(C[:, 3], C[:, 4]), np.abs(C[:, :2]).max(axis=1)
    return np.asarray(C / np.where(yaw > 0.0, yaw, np.where(tilt > 0.0, tilt, slide))[:, None])


@dataclass(frozen=True, slots=True)
class Rectangle:
    """Rectangle about the origin of the contact frame."""

    half_length: float  # half of the side along x, m
    half_width: float  # half of the side along y, m

    @property
    def vertices(self) -> Array:
        """Corners in order, (4, 2) in m."""
        x, y = self.half_length, self.half_width
        return np.array([[x, y], [x, -y], [-x, -y], [-x, y]])

    def cone(self, friction: float) -> Array:
        """Return the rows of `wrench_cone`."""
        return wrench_cone(friction, self.half_length, self.half_width)


class Polygon:
    """Convex polygon in the plane z = 0 of the contact frame."""

    def __init__(self, vertices: Array, key: str) -> None:
        """Make a polygon from the corners of a convex polygon, (n, 2) in m, in any order."""
        points = np.array(vertices, dtype=np.float64)
        if len(points) < 3:
            raise ConfigurationError(f"{key} has {len(points)} vertices; a polygon needs at least three")
        try:
            hull = ConvexHull(points)
        except QhullError as error:
            raise ConfigurationError(f"{key} = {points.tolist()}: the vertices are on one line") from error
        for index, (point, is_corner) in enumerate(zip(points, are_corners(points), strict=True)):
            if not is_corner:
                raise ConfigurationError(
                    f"{key}[{index}] = {point.tolist()}: not a corner, but a point on or inside the polygon of the "
                    "other vertices; the polygon must be convex: remove the point"
                )
        self.vertices: Array = points[hull.vertices]  # in order, (n, 2) in m

    def cone(self, friction: float) -> Array:
        """Return the rows of `polygon_wrench_cone`."""
        return polygon_wrench_cone(friction, self.vertices)


def are_corners(points: Array) -> list[bool]:
    """Return which points, (n, 2) in m, are outside the convex hull of the others."""
    least = _CORNER * float(np.abs(points - points.mean(axis=0)).max())
    return [_is_outside_hull(np.delete(points, index, axis=0), point, least) for index, point in enumerate(points)]


def support_polygon(points: Array) -> Array:
    """Return the corners of the convex hull of points (n, 2) in order; none without area."""
    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except (QhullError, ValueError):
        return points[:0]


def _is_outside_hull(others: Array, point: Array, least: float) -> bool:
    try:
        hull = ConvexHull(others)
    except QhullError:
        return len(others) < 3 or bool(np.linalg.norm(others - point, axis=1).min() > least)
    return bool((hull.equations[:, :2] @ point + hull.equations[:, 2]).max() > least)


Support = Rectangle | Polygon
