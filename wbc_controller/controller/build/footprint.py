"""Contact region of a body on a plane."""

from collections.abc import Sequence
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull, QhullError

from wbc_controller.controller.build.collision_elements import enclosing_points
from wbc_controller.records import Array, frozen

LAYER = 0.005  # thickness of the layer above the lowest point, m: about the radius of rounded sole edges
_AROUND = 128  # points on a circle
_MERIDIANS, _RINGS = 24, 12  # points around a sphere, and rings between its poles
_UNDERSIDE = np.cos(np.pi / 4.0)  # cosine of the largest angle between plane and underside, 45°
_FLAT = np.cos(np.pi / 180.0)  # cosine of the largest angle between facets of one flat face, 1°
_FACE = 0.25  # smallest share of the underside that counts as a flat face
_DIGITS = 6  # decimals of footprint coordinates in m
_CANDIDATES = 50  # number of largest facets in the search of a flat face


@dataclass(frozen=True, slots=True)
class Footprint:
    """Contact region of a body on a plane, moved along its normal until they touch."""

    polygon: Array  # counterclockwise corners, (n, 2) in m; also a point or a line
    height: float  # height of the body's lowest point above the plane, m
    tilt: float | None  # angle between plane and largest flat face of the underside, rad; None without one

    @property
    def size(self) -> Array:
        """Sides of the bounding rectangle along x and y, (2,) in m."""
        return np.asarray(np.ptp(self.polygon, axis=0))

    def outside(self, points: Array) -> Array:
        """Return the distance of points, (k, 2) in m, from the polygon, (k,) in m; 0 inside."""
        edges = np.roll(self.polygon, -1, axis=0) - self.polygon  # (n, 2)
        lengths = np.maximum((edges**2).sum(axis=1), 1.0e-18)
        apart = points[:, None, :] - self.polygon  # (k, n, 2)
        along = np.clip((apart * edges).sum(axis=2) / lengths, 0.0, 1.0)
        distance = np.linalg.norm(apart - along[:, :, None] * edges, axis=2).min(axis=1)
        left = edges[:, 0] * apart[:, :, 1] - edges[:, 1] * apart[:, :, 0]
        within = (left >= 0.0).all(axis=1) & (len(self.polygon) > 2)
        return np.where(within, 0.0, distance)


def footprint(elements: Sequence[pin.GeometryObject], plane: pin.SE3, layer: float = LAYER) -> Footprint | None:
    """Return the footprint on a plane of elements moved by one joint; None without elements.

    `plane` is in the joint's frame, its z axis points to the body; `layer` is the thickness above the lowest point, m.
    """
    if not elements:
        return None

    def seen(points: Sequence[Array]) -> Array:
        return np.asarray((np.vstack(points) - plane.translation) @ plane.rotation)  # (n, 3) in the plane's frame

    points = seen([outline(element, plane.rotation) for element in elements])
    touching = seen([_touching(element, plane.rotation) for element in elements])
    height = float(points[:, 2].min())
    low = touching[touching[:, 2] <= height + layer, :2]
    return Footprint(frozen(_convex(low)), height, _tilt(points, height))


def outline(element: pin.GeometryObject, axes: Array | None = None) -> Array:
    """Return points on an element's surface that span its convex hull, (n, 3) in m in the joint's frame.

    Poles of spheres lie on the third of `axes`, (3, 3), by default the joint's.
    """
    geometry, placement = element.geometry, element.placement
    if isinstance(geometry, coal.Sphere | coal.Capsule):
        ball = geometry.radius * _sphere() @ (np.eye(3) if axes is None else axes).T
        return np.vstack([ball + centre for centre in _centres(element)])
    if isinstance(geometry, coal.Cylinder):
        turn = np.linspace(0.0, 2.0 * np.pi, _AROUND, endpoint=False)
        rim = geometry.radius * np.column_stack([np.cos(turn), np.sin(turn)])
        sides = [np.column_stack([rim, np.full(_AROUND, side * geometry.halfLength)]) for side in (1.0, -1.0)]
        return np.asarray(np.vstack(sides) @ placement.rotation.T + placement.translation)
    return enclosing_points(element)


def simplify_polygon(polygon: Array, most: int) -> Array:
    """Remove corners of a convex polygon, (n, 2) or (n, 3), smallest area first, until `most` remain."""
    corners = np.pad(polygon, ((0, 0), (0, 3 - polygon.shape[1])))
    while len(corners) > most:
        before, after = np.roll(corners, 1, axis=0) - corners, np.roll(corners, -1, axis=0) - corners
        corners = np.delete(corners, np.argmin(np.linalg.norm(np.cross(after, before), axis=1)), axis=0)
    return np.asarray(corners[:, : polygon.shape[1]])


def fit_sphere(points: Array) -> tuple[Array, float] | None:
    """Return centre, (3,), and radius of the least-squares sphere of points, (n, 3); None for coplanar points.

    |p - c|² = r² is linear in c and r² - |c|².
    """
    origin = points.mean(axis=0)
    around = points - origin
    terms = np.column_stack([2.0 * around, np.ones(len(around))])
    (*centre, rest), _, rank, _ = np.linalg.lstsq(terms, np.sum(around**2, axis=1), rcond=1.0e-6)
    return None if rank < 4 else (origin + centre, float(np.sqrt(rest + np.dot(centre, centre))))


def _touching(element: pin.GeometryObject, axes: Array) -> Array:
    """Return outline points that may touch a plane, (n, 3); of a ball the lowest one."""
    geometry = element.geometry
    if not isinstance(geometry, coal.Sphere | coal.Capsule):
        return outline(element, axes)
    return np.asarray(_centres(element) - geometry.radius * axes[:, 2])


def _centres(element: pin.GeometryObject) -> Array:
    half = element.geometry.halfLength if isinstance(element.geometry, coal.Capsule) else 0.0
    ends = [np.array([0.0, 0.0, side * half]) for side in ((1.0, -1.0) if half else (1.0,))]
    return np.array([element.placement.act(end) for end in ends])


def _sphere() -> Array:
    polar, turn = np.meshgrid(
        np.linspace(0.0, np.pi, _RINGS + 1), np.linspace(0.0, 2.0 * np.pi, _MERIDIANS, endpoint=False)
    )
    points = np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)])
    return np.asarray(points.reshape(3, -1).T)


def _convex(points: Array) -> Array:
    """Return the convex hull of points, (n, 2); for collinear points the ends."""
    points = np.unique(np.round(points, _DIGITS), axis=0)
    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:  # fewer than three, or collinear
        along = points @ (points[np.argmax(np.linalg.norm(points - points[0], axis=1))] - points[0])
        return np.asarray(points[np.unique([np.argmin(along), np.argmax(along)])])


def _tilt(points: Array, height: float) -> float | None:
    """Return the angle between z and the largest flat face of the underside, rad; None without a flat face."""
    try:
        hull = ConvexHull(points)
    except QhullError:  # a flat body
        return None
    down = -hull.equations[:, 2] > _UNDERSIDE
    normals, corners = hull.equations[down, :3], points[hull.simplices[down]]  # (k, 3), (k, 3, 3)
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    candidates = np.argsort(areas)[-_CANDIDATES:]
    parallel = normals[candidates] @ normals.T > _FLAT  # (c, k) facets parallel to each candidate
    faces = parallel @ areas
    if not faces.size or not faces.max() > _FACE * float(areas.sum()):
        return None
    members = parallel[int(np.argmax(faces))]
    if not corners[members, :, 2].min() <= height + LAYER:  # the face is above the touching layer
        return None
    mean = areas[members] @ normals[members]
    return float(np.arccos(np.clip(-mean[2] / np.linalg.norm(mean), -1.0, 1.0)))
