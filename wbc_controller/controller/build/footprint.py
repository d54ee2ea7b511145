"""The footprint of a body: what of its collision shapes is near a plane, such as the floor below a sole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull, QhullError

from wbc_controller.controller.build.collision_elements import enclosing_points
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array, frozen

#: Thickness of the layer above a body's lowest point that counts as its footprint, m: the edges of soles are rounded by
#: about this much, and rubber gives way by less.
LAYER = 0.005
#: Points around a circle: the lowest of a wheel's is within 0.03 % of the radius of the true one.
_AROUND = 128
#: Points around a sphere, and rings between its poles: few, as hulls of balls take most of the time.
_MERIDIANS, _RINGS = 24, 12
#: Cosine of the largest angle between a plane and the flat underside that is meant to lie on it, 45°.
_UNDERSIDE = np.cos(np.pi / 4.0)
#: Facets of a hull whose normals differ by less than this, as the cosine of 1°, belong to one flat face.
_FLAT = np.cos(np.pi / 180.0)
#: Least share of a body's underside that is a flat face: a ball's facets are all alike.
_FACE = 0.25
#: Decimals that count in a footprint, m: points nearer than a micrometre are one.
_DIGITS = 6
#: Number of facets, the largest ones, around which a flat face is looked for.
_CANDIDATES = 50


@dataclass(frozen=True, slots=True)
class Footprint:
    """Where a body touches a plane that is moved along its normal until they meet.

    Attributes:
        polygon: corners of the convex footprint, counterclockwise, (n, 2) in m, in the x and y axes of the plane's
            frame; a single point or a line where the body has no more.
        height: of the body's lowest point above the plane, m; negative where the body reaches through it.
        tilt: angle between the plane and the largest flat face of the body's underside, rad; None for a body without
            one, such as a ball.
    """

    polygon: Array
    height: float
    tilt: float | None

    @property
    def size(self) -> Array:
        """Sides of the smallest rectangle along x and y around the polygon, (2,) in m."""
        return np.asarray(np.ptp(self.polygon, axis=0))

    def outside(self, points: Array) -> Array:
        """Distance of points, (k, 2) in m in the plane's frame, from the polygon, (k,) in m; 0 for those within it."""
        ends = np.roll(self.polygon, -1, axis=0)
        edges = ends - self.polygon  # (n, 2)
        lengths = np.maximum((edges**2).sum(axis=1), 1.0e-18)
        apart = points[:, None, :] - self.polygon  # (k, n, 2)
        along = np.clip((apart * edges).sum(axis=2) / lengths, 0.0, 1.0)
        distance = np.linalg.norm(apart - along[:, :, None] * edges, axis=2).min(axis=1)
        left = edges[:, 0] * apart[:, :, 1] - edges[:, 1] * apart[:, :, 0]
        within = (left >= 0.0).all(axis=1) & (len(self.polygon) > 2)
        return np.where(within, 0.0, distance)


def footprint(
    model: RobotModel,
    elements: Mapping[int, Sequence[pin.GeometryObject]],
    joint: int,
    plane: pin.SE3,
    layer: float = LAYER,
) -> Footprint | None:
    """Find the footprint of a body on a plane; None if no link of the body has a collision element.

    The body is all links that one joint moves: a foot that is fixed to its shank belongs to the shank's body. Its
    shapes count as their convex hull, as a plane meets nothing else.

    Args:
        elements: the collision elements by the number of the link's frame, of `read_collision_elements`.
        joint: number of the joint in the Pinocchio model; 1 is that of a floating base, 0 the world.
        plane: placement in the joint's frame of the plane's own frame: x and y span the plane, and z is its normal,
            which points to the body's side.
        layer: thickness of the layer above the body's lowest point that counts, m.
    """
    shapes = [
        element
        for frame, own in elements.items()
        if model.pinocchio.frames[frame].parentJoint == joint
        for element in own
    ]
    if not shapes:
        return None

    def seen(points: Sequence[Array]) -> Array:
        return np.asarray((np.vstack(points) - plane.translation) @ plane.rotation)  # (n, 3) in the plane's frame

    points = seen([outline(element, plane.rotation) for element in shapes])
    touching = seen([_touching(element, plane.rotation) for element in shapes])
    height = float(points[:, 2].min())
    low = touching[touching[:, 2] <= height + layer, :2]
    return Footprint(frozen(_convex(low)), height, _tilt(points, height))


def outline(element: pin.GeometryObject, axes: Array | None = None) -> Array:
    """Points on the surface of an element, (n, 3) in m in its joint's frame, whose convex hull is that of the element.

    The poles of spheres are along the last of the axes, (3, 3) as columns in that frame, by default its own, so that
    the lowest point along it is exact.
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
    """Leave out of a convex polygon, (n, 2) or (n, 3), the corners that cut off the least area, until it has few."""
    corners = np.pad(polygon, ((0, 0), (0, 3 - polygon.shape[1])))
    while len(corners) > most:
        before, after = np.roll(corners, 1, axis=0) - corners, np.roll(corners, -1, axis=0) - corners
        corners = np.delete(corners, np.argmin(np.linalg.norm(np.cross(after, before), axis=1)), axis=0)
    return np.asarray(corners[:, : polygon.shape[1]])


def fit_sphere(points: Array) -> tuple[Array, float] | None:
    """Centre, (3,), and radius of the ball that fits points, (n, 3), best; None if they are in one plane.

    |p - c|² = r² is linear in c and in r² - |c|².
    """
    origin = points.mean(axis=0)
    around = points - origin
    terms = np.column_stack([2.0 * around, np.ones(len(around))])
    (*centre, rest), _, rank, _ = np.linalg.lstsq(terms, np.sum(around**2, axis=1), rcond=1.0e-6)
    return None if rank < 4 else (origin + centre, float(np.sqrt(rest + np.dot(centre, centre))))


def _touching(element: pin.GeometryObject, axes: Array) -> Array:
    """Points of an element's outline that may touch a plane with these axes, (n, 3): of a ball the lowest one alone."""
    geometry = element.geometry
    if not isinstance(geometry, coal.Sphere | coal.Capsule):
        return outline(element, axes)
    return np.asarray(_centres(element) - geometry.radius * axes[:, 2])


def _centres(element: pin.GeometryObject) -> Array:
    """Centres of a sphere, or of the two at the ends of a capsule, (n, 3) in m."""
    half = element.geometry.halfLength if isinstance(element.geometry, coal.Capsule) else 0.0
    ends = [np.array([0.0, 0.0, side * half]) for side in ((1.0, -1.0) if half else (1.0,))]
    return np.array([element.placement.act(end) for end in ends])


def _sphere() -> Array:
    """Points on the unit sphere, rings between the two poles on z."""
    polar, turn = np.meshgrid(
        np.linspace(0.0, np.pi, _RINGS + 1), np.linspace(0.0, 2.0 * np.pi, _MERIDIANS, endpoint=False)
    )
    points = np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)])
    return np.asarray(points.reshape(3, -1).T)


def _convex(points: Array) -> Array:
    """Corners of the convex hull of points in a plane, (n, 2); of points on a line its ends, or one."""
    points = np.unique(np.round(points, _DIGITS), axis=0)
    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:  # fewer than three, or all on one line
        along = points @ (points[np.argmax(np.linalg.norm(points - points[0], axis=1))] - points[0])
        return np.asarray(points[np.unique([np.argmin(along), np.argmax(along)])])


def _tilt(points: Array, height: float) -> float | None:
    """Angle between z and the largest flat face of the underside of a body at some height, rad; None without one."""
    try:
        hull = ConvexHull(points)
    except QhullError:  # a flat body
        return None
    down = -hull.equations[:, 2] > _UNDERSIDE
    normals, corners = hull.equations[down, :3], points[hull.simplices[down]]  # (k, 3), (k, 3, 3)
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    candidates = np.argsort(areas)[-_CANDIDATES:]
    alike = normals[candidates] @ normals.T > _FLAT  # (c, k) the facets that lie flat with each candidate
    faces = alike @ areas
    if not faces.size or not faces.max() > _FACE * float(areas.sum()):
        return None
    members = alike[int(np.argmax(faces))]
    if not corners[members, :, 2].min() <= height + LAYER:  # the face is another one, above what touches
        return None
    mean = areas[members] @ normals[members]
    return float(np.arccos(np.clip(-mean[2] / np.linalg.norm(mean), -1.0, 1.0)))
