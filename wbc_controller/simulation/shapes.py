"""The collision shapes of the URDF, with which the mock robot touches the floor.

Boxes, spheres, cylinders and capsules are taken as they are, meshes by their convex hulls. A floor touches a hull at
its vertices, so that a hull may be taken apart: a sole becomes balls at the corners of its outline, a round tip one
ball, and the rest of the hull stays a mesh. A wheel becomes a thin rim.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coal
import mujoco
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull, QhullError

from wbc_controller.controller.build.collision_elements import enclosing_points, read_collision_elements
from wbc_controller.controller.build.footprint import fit_sphere, outline, simplify_polygon
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array

#: Radius of the balls at the corners of a sole, m: small, so that its outline stays where it is.
CORNER_RADIUS = 0.001
#: Half the thickness of a wheel, m: it touches with its rim.
RIM_RADIUS = 0.001
#: Unevenness of a mesh that is still a flat sole, m: thinned-out meshes of flat soles have a millimetre or two. As it
#: is, such a hull would rock on three points; MuJoCo gives a mesh on a plane three points in any case, and where they
#: change, a standing robot shakes.
SOLE_DEPTH = 0.002
#: Part of a foot to which a ball is fitted, from its lowest point up, m.
TIP_DEPTH = 0.008
#: Unevenness of a mesh that is still a round tip, m. A thinned-out ball has facets: it would stand on the corner of
#: one, up to half a facet beside the point where the ball itself does, and jump from corner to corner as it rolls.
TIP_ERROR = 0.001
#: Corners of a sole's outline at most: each costs the physics a contact.
MOST_CORNERS = 12
#: Cosine of the angle between the normals of one sole, at most 3°.
_PARALLEL = 0.9986
#: Smallest radius, and half the smallest thickness, of a shape without a volume, m.
_THINNEST = 0.0005


@dataclass(frozen=True, slots=True)
class Shape:
    """A convex shape on the link of a Pinocchio joint."""

    kind: Any
    placement: pin.SE3  # of the shape in the joint's frame
    size: tuple[float, ...] = ()  # MuJoCo's sizes of that type, m; empty for a mesh
    points: Array | None = None  # vertices of a mesh in the joint's frame, (n, 3) in m; None for others


def read_shapes(
    model: RobotModel,
    soles: Mapping[int, Sequence[Array]],
    tips: Mapping[int, Array],
    wheels: Mapping[int, pin.SE3],
    folder: Path | None = None,
) -> dict[int, list[Shape]]:
    """Read the collision shapes of a robot's URDF.

    Args:
        soles: by Pinocchio joint, the outward normals of the soles of its links, in the joint's frame, (3,) each.
        tips: by Pinocchio joint whose links stand on a point, the direction downwards in the nominal posture, in the
            joint's frame, (3,).
        wheels: by Pinocchio joint, the placement of a wheel in the joint's frame, with z along the axle.
        folder: folder of meshes that are named by a relative path.

    Returns:
        By Pinocchio joint, the shapes of the links that it moves; without those that nothing moves.

    Raises:
        ConfigurationError: if a mesh cannot be found or read.
    """
    by_joint: dict[int, list[pin.GeometryObject]] = {}
    for elements in read_collision_elements(model, model.urdf, "robot.urdf", folder).values():
        for element in elements:
            by_joint.setdefault(int(element.parentJoint), []).append(element)
    by_joint.pop(0, None)
    shapes: dict[int, list[Shape]] = {}
    for joint, elements in by_joint.items():
        if joint in wheels:
            shapes[joint] = [_rim(elements, wheels[joint])]
            continue
        shapes[joint] = [shape for shape in map(_primitive, elements) if shape is not None]
        hulls = [_hull(enclosing_points(element)) for element in elements if _primitive(element) is None]
        for normal in _different(soles.get(joint, ())) if hulls else ():
            lowest = max(float(np.max(hull @ normal)) for hull in hulls)
            for index, hull in enumerate(hulls):
                balls, hulls[index] = _part_sole(hull, normal, lowest)
                shapes[joint] += balls
        if joint in tips and hulls:
            index = int(np.argmax([np.max(hull @ tips[joint]) for hull in hulls]))
            balls, hulls[index] = _part_tip(hulls[index], tips[joint])
            shapes[joint] += balls
        shapes[joint] += [_mesh(hull) for hull in hulls if len(hull)]
    return shapes


def add_shape(spec: Any, body: Any, shape: Shape, name: str) -> Any:
    """Add a shape to a body of MuJoCo's specification, without mass, and return its geom."""
    geom = body.add_geom(type=shape.kind, name=name, mass=0.0)
    if shape.points is None:
        geom.size = [*(max(size, _THINNEST) for size in shape.size), 0.0, 0.0, 0.0][:3]  # MuJoCo refuses 0
        geom.pos = shape.placement.translation
        geom.quat = np.array(pin.SE3ToXYZQUAT(shape.placement))[[6, 3, 4, 5]]
    else:
        mesh = spec.add_mesh(name=name)
        mesh.uservert = shape.points.ravel().tolist()
        geom.meshname = name
    return geom


def _rim(elements: Sequence[pin.GeometryObject], wheel: pin.SE3) -> Shape:
    """Return the rim of a wheel with the radius of its elements: a tyre has no edges on which it tilts, a tread has."""
    points = np.vstack([outline(element) for element in elements])
    across = ((points - wheel.translation) @ wheel.rotation)[:, :2]
    radius = float(np.linalg.norm(across, axis=1).max())
    return Shape(mujoco.mjtGeom.mjGEOM_ELLIPSOID, wheel, (radius, radius, RIM_RADIUS))


def _different(normals: Sequence[Array]) -> list[Array]:
    """Return the normals, (3,) each, without duplicates of a sole that several contacts share."""
    found: list[Array] = []
    for normal in normals:
        if all(normal @ other < _PARALLEL for other in found):
            found.append(normal)
    return found


def _primitive(element: pin.GeometryObject) -> Shape | None:
    """Return the shape of an element; None for a mesh."""
    geometry, kinds = element.geometry, mujoco.mjtGeom
    match geometry:
        case coal.Sphere():
            return Shape(kinds.mjGEOM_SPHERE, element.placement, (geometry.radius,))
        case coal.Box():
            return Shape(kinds.mjGEOM_BOX, element.placement, tuple(geometry.halfSide))
        case coal.Cylinder():
            return Shape(kinds.mjGEOM_CYLINDER, element.placement, (geometry.radius, geometry.halfLength))
        case coal.Capsule():
            return Shape(kinds.mjGEOM_CAPSULE, element.placement, (geometry.radius, geometry.halfLength))
    return None


def _hull(points: Array) -> Array:
    """Return the vertices of the convex hull of points, (n, 3); all points if they have no volume."""
    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:
        return points


def _part_sole(hull: Array, normal: Array, lowest: float) -> tuple[list[Shape], Array]:
    """Split a hull into balls at the corners of its sole, if it has one, and the vertices behind them.

    The sole of the whole link reaches `lowest` along the outward normal of the sole, m.
    """
    depth = lowest - hull @ normal
    low = depth < SOLE_DEPTH
    flat = hull[low] + np.outer(depth[low], normal)
    try:
        outline = ConvexHull(flat @ np.linalg.svd(normal[None, :])[2][1:].T)
    except (QhullError, ValueError):  # less than three corners, or all in a line: an edge or a tip, which is no sole
        return [], hull
    corners = simplify_polygon(flat[outline.vertices], MOST_CORNERS)
    # The mesh keeps off the floor as long as the sole is on it.
    behind = np.where(low[:, None], hull - np.outer(SOLE_DEPTH - depth, normal), hull)
    balls = [
        Shape(mujoco.mjtGeom.mjGEOM_SPHERE, pin.SE3(np.eye(3), corner - CORNER_RADIUS * normal), (CORNER_RADIUS,))
        for corner in corners
    ]
    return balls, behind


def _part_tip(hull: Array, down: Array) -> tuple[list[Shape], Array]:
    """Split a hull into the ball of its tip, if it is round in the direction `down`, and the vertices outside of it."""
    reach = hull @ down
    tip = hull[reach > reach.max() - TIP_DEPTH]
    fitted = fit_sphere(tip)
    if fitted is None or len(tip) <= 4:  # four points make a ball, more tell whether there is one
        return [], hull
    centre, radius = fitted
    off = np.linalg.norm(hull - centre, axis=1) - radius
    if not np.abs(off[reach > reach.max() - TIP_DEPTH]).max() < TIP_ERROR:
        return [], hull
    ball = Shape(mujoco.mjtGeom.mjGEOM_SPHERE, pin.SE3(np.eye(3), centre), (radius,))
    return [ball], hull[off > TIP_ERROR]


def _mesh(hull: Array) -> Shape:
    """Return the mesh of a hull, or a box around a hull without volume, which MuJoCo does not accept as a mesh."""
    try:
        vertices = hull[ConvexHull(hull).vertices]
    except QhullError:
        low, high = hull.min(axis=0), hull.max(axis=0)
        half = np.maximum(0.5 * (high - low), _THINNEST)
        return Shape(mujoco.mjtGeom.mjGEOM_BOX, pin.SE3(np.eye(3), 0.5 * (low + high)), tuple(half))
    return Shape(mujoco.mjtGeom.mjGEOM_MESH, pin.SE3.Identity(), points=vertices)
