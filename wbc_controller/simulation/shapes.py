"""Shapes that touch the floor.

Meshes become convex hulls. A sole becomes balls at the corners of its outline, a round tip one ball, a wheel a thin
rim.
"""

import logging
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
from wbc_controller.controller.build.contacts import contact_placement
from wbc_controller.controller.build.footprint import fit_sphere, outline, simplify_polygon
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.robot.orientation import quaternion_of
from wbc_controller.records import Array
from wbc_controller.settings.contacts import ContactSettings, FixedContact, PointContact, RollingContact, SurfaceContact

_log = logging.getLogger(__name__)

CORNER_RADIUS = 0.001  # radius of the balls at the corners of a sole, m
RIM_RADIUS = 0.001  # half thickness of a wheel's rim, m
SOLE_DEPTH = 0.002  # unevenness of a flat sole, m; its hull would rock
TIP_DEPTH = 0.008  # height of the tip to which a ball is fitted, m
TIP_ERROR = 0.001  # unevenness of a round tip, m; its facets would jump
MOST_CORNERS = 12  # largest number of corners of a sole
_PARALLEL = 0.9986  # least cosine between equal sole normals, 3°
_LEAST_SIZE = 0.0005  # least radius and half thickness of a shape, m


@dataclass(frozen=True, slots=True)
class Shape:
    """Convex shape on the link of a Pinocchio joint."""

    kind: Any
    placement: pin.SE3  # in the joint's frame
    size: tuple[float, ...] = ()  # MuJoCo's sizes, m; empty for a mesh
    points: Array | None = None  # vertices of a mesh in the joint's frame, (n, 3) in m


def read_shapes(
    model: RobotModel, contacts: Mapping[str, ContactSettings], normal: Array, folder: Path | None
) -> dict[int, list[Shape]]:
    """Read the collision shapes by Pinocchio joint, and warn of links of contacts without shapes.

    `normal` is that of the floor, (3,); `folder` contains the meshes with relative paths.
    """
    standing = {
        name: contact_placement(model, name, contact)
        for name, contact in contacts.items()
        if contact.against is None and not isinstance(contact, FixedContact)
    }
    data = model.pinocchio.createData()
    pin.forwardKinematics(model.pinocchio, data, model.configuration(model.posture))
    elements: dict[int, list[pin.GeometryObject]] = {}
    shapes: dict[int, list[Shape]] = {}
    why = "have no collision element in the URDF"
    try:
        for element in read_collision_elements(model, model.urdf, "robot.urdf", folder):
            elements.setdefault(int(element.parentJoint), []).append(element)
        elements.pop(0, None)
        for joint, own in elements.items():
            feet = [(contacts[name], placement) for name, (at, placement) in standing.items() if at == joint]
            shapes[joint] = _shapes_of_link(own, feet, -data.oMi[joint].rotation.T @ normal)
    except ConfigurationError as error:  # meshes are optional
        shapes, why = {}, f"have no shapes ({error})"
    bare = [name for name, (joint, _) in standing.items() if joint not in shapes]
    if bare:
        text = "the links of the contacts %s %s: the mock robot uses the contact shapes of the configuration"
        _log.warning(text, ", ".join(bare), why)
    return shapes


def _shapes_of_link(
    elements: Sequence[pin.GeometryObject], feet: Sequence[tuple[ContactSettings, pin.SE3]], down: Array
) -> list[Shape]:
    """Return the shapes of a link with some contacts and their placements, in the joint's frame.

    `down` is the direction to the floor, (3,).
    """
    wheels = [(contact, placement) for contact, placement in feet if isinstance(contact, RollingContact)]
    if wheels:
        contact, placement = wheels[-1]
        return [_wheel_rim(elements, placement * pin.SE3(rotation_to(np.array(contact.axis)), np.zeros(3)))]
    shapes = [shape for shape in map(_primitive, elements) if shape is not None]
    hulls = [enclosing_points(element) for element in elements if _primitive(element) is None]
    if feet:
        hulls = [_hull(points) for points in hulls]
    soles = [-placement.rotation[:, 2] for contact, placement in feet if isinstance(contact, SurfaceContact)]
    for normal in _distinct_normals(soles) if hulls else ():
        lowest = max(float(np.max(hull @ normal)) for hull in hulls)
        for index, hull in enumerate(hulls):
            balls, hulls[index] = _split_sole(hull, normal, lowest)
            shapes += balls
    if hulls and any(isinstance(contact, PointContact) for contact, _ in feet):
        index = int(np.argmax([np.max(hull @ down) for hull in hulls]))
        balls, hulls[index] = _split_tip(hulls[index], down)
        shapes += balls
    return shapes + [_mesh(hull) for hull in hulls if len(hull)]


def rotation_to(direction: Array) -> Array:
    """Return a rotation from z to a direction, (3, 3)."""
    rotation: Array = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), direction).toRotationMatrix()
    return rotation


def wxyz(rotation: Array) -> Array:
    """Return MuJoCo's quaternion (w, x, y, z) of a rotation, (3, 3)."""
    return quaternion_of(rotation)[[3, 0, 1, 2]]


def add_shape(spec: Any, body: Any, shape: Shape, name: str, bit: int) -> None:
    """Add a massless shape, which touches geoms of a collision bit, to a body of a MuJoCo specification."""
    geom = body.add_geom(type=shape.kind, name=name, mass=0.0, contype=0, conaffinity=bit)
    if shape.points is None:
        geom.size = [*(max(size, _LEAST_SIZE) for size in shape.size), 0.0, 0.0, 0.0][:3]  # MuJoCo refuses 0
        geom.pos = shape.placement.translation
        geom.quat = wxyz(shape.placement.rotation)
    else:
        mesh = spec.add_mesh(name=name)
        mesh.uservert = shape.points.ravel().tolist()
        geom.meshname = name


def _wheel_rim(elements: Sequence[pin.GeometryObject], wheel: pin.SE3) -> Shape:
    """Return the rim of a wheel with the radius of its elements; tyres and treads have edges."""
    points = np.vstack([outline(element) for element in elements])
    across = ((points - wheel.translation) @ wheel.rotation)[:, :2]
    radius = float(np.linalg.norm(across, axis=1).max())
    return Shape(mujoco.mjtGeom.mjGEOM_ELLIPSOID, wheel, (radius, radius, RIM_RADIUS))


def _distinct_normals(normals: Sequence[Array]) -> list[Array]:
    found: list[Array] = []
    for normal in normals:
        if all(normal @ other < _PARALLEL for other in found):
            found.append(normal)
    return found


def _primitive(element: pin.GeometryObject) -> Shape | None:
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
    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:
        return points


def _split_sole(hull: Array, normal: Array, lowest: float) -> tuple[list[Shape], Array]:
    """Split a hull into balls at the corners of its sole, if any, and the vertices behind it."""
    depth = lowest - hull @ normal
    low = depth < SOLE_DEPTH
    flat = hull[low] + np.outer(depth[low], normal)
    try:
        outline = ConvexHull(flat @ np.linalg.svd(normal[None, :])[2][1:].T)
    except (QhullError, ValueError):  # an edge or a tip
        return [], hull
    corners = simplify_polygon(flat[outline.vertices], MOST_CORNERS)
    # Keep the mesh off the floor.
    behind = np.where(low[:, None], hull - np.outer(SOLE_DEPTH - depth, normal), hull)
    balls = [
        Shape(mujoco.mjtGeom.mjGEOM_SPHERE, pin.SE3(np.eye(3), corner - CORNER_RADIUS * normal), (CORNER_RADIUS,))
        for corner in corners
    ]
    return balls, behind


def _split_tip(hull: Array, down: Array) -> tuple[list[Shape], Array]:
    """Split a hull into the ball of its tip, if round in the direction `down`, and the vertices outside."""
    reach = hull @ down
    tip = hull[reach > reach.max() - TIP_DEPTH]
    fitted = fit_sphere(tip)
    if fitted is None or len(tip) <= 4:  # four points always fit a ball
        return [], hull
    centre, radius = fitted
    off = np.linalg.norm(hull - centre, axis=1) - radius
    if not np.abs(off[reach > reach.max() - TIP_DEPTH]).max() < TIP_ERROR:
        return [], hull
    ball = Shape(mujoco.mjtGeom.mjGEOM_SPHERE, pin.SE3(np.eye(3), centre), (radius,))
    return [ball], hull[off > TIP_ERROR]


def _mesh(hull: Array) -> Shape:
    try:
        vertices = hull[ConvexHull(hull).vertices]
    except QhullError:
        low, high = hull.min(axis=0), hull.max(axis=0)
        half = np.maximum(0.5 * (high - low), _LEAST_SIZE)
        return Shape(mujoco.mjtGeom.mjGEOM_BOX, pin.SE3(np.eye(3), 0.5 * (low + high)), tuple(half))
    return Shape(mujoco.mjtGeom.mjGEOM_MESH, pin.SE3.Identity(), points=vertices)
