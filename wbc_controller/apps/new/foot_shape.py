"""Shape of a foot: a flat sole, a ball or a wheel."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull, QhullError

from wbc_controller.controller.build.footprint import fit_sphere, footprint, outline, simplify_polygon
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array

_DOWN = np.cos(np.radians(30.0))  # largest angle between ground and sole, 30°
#: Cosine of the largest angle between facet normals of a sole, 3°, and of a flat face, 0.3°.
_ALIKE, _FLAT = np.cos(np.radians(3.0)), np.cos(np.radians(0.3))
#: Smallest area of a sole in m², as a share of the outline from below, and smallest length of its shorter side, m.
_LEAST_AREA, _LEAST_SHARE, _LEAST_SIDE = 4.0e-4, 0.25, 0.015
#: Thickness of the layers above the sole's plane, m, in order, and required share of the sole within; edges may be
#: round.
_LAYERS, _LAYER_SHARE = (2.0e-4, 1.0e-3, 3.0e-3), 0.6
_RECTANGLE = 0.97  # share of the bounding rectangle
_MOST_CORNERS = 8  # largest number of corners of a sole
_LINE = 1.0e-3  # smallest width of a plane set of points, as a share of its length
_ROUND, _SECTORS = 0.97, 24  # smallest radius of a wheel's rim as a share of the largest, and number of checked sectors
_CONTINUOUS_RANGE = 1.9 * np.pi  # smallest range of a continuous joint, rad
#: Largest deviation of a ball from a sphere, as a share of the radius, and largest radius, m.
_BALL, _LARGEST_BALL = 0.15, 0.15
_CAP = 0.5  # angle around the downward direction, 60°
UNKNOWN_RADIUS = 0.01  # m


@dataclass(frozen=True, slots=True)
class Foot:
    """A foot."""

    joint: int  # index in the Pinocchio model
    link: str
    kind: Literal["surface", "point", "rolling"]
    #: Contact placement in the joint's frame. Sole: middle, z along the inward normal, x forward. Ball or wheel:
    #: centre, axes of the joint.
    placement: pin.SE3
    #: Of a sole, (n, 2) in m, in the axes of `placement`; otherwise empty.
    corners: Array = field(default_factory=lambda: np.zeros((0, 2)))
    rectangle: bool = False  # True if the corners form a rectangle along these axes
    radius: float = 0.0  # of a ball or wheel, m
    axis: Array = field(default_factory=lambda: np.zeros(3))  # of a wheel, in the joint's frame, (3,)
    measured_on: str = ""  # measured geometry in words; empty if the radius is a guess


def links_of(model: RobotModel, joint: int) -> list[pin.Frame]:
    """Return the frames of the links moved by a joint."""
    return [frame for frame in model.pinocchio.frames if frame.parentJoint == joint and frame.type == pin.BODY]


def measure(
    model: RobotModel, elements: Sequence[pin.GeometryObject], joint: int, upward: pin.SE3, axis: Array
) -> Foot:
    """Measure a foot; `upward` has the base's axes in the joint's frame, x forward and z up."""
    own = [element for element in elements if element.parentJoint == joint]
    down = -upward.rotation[:, 2]
    if not own:
        end = max(links_of(model, joint), key=lambda frame: float(frame.placement.translation @ down))
        placement = pin.SE3(np.eye(3), end.placement.translation)
        return Foot(joint, str(end.name), "point", placement, radius=UNKNOWN_RADIUS)
    shapes = [outline(element, upward.rotation) for element in own]
    lowest = int(np.argmax([float((points @ down).max()) for points in shapes]))
    frame, points = own[lowest].parentFrame, np.vstack(shapes)
    link = str(model.pinocchio.frames[frame].name)
    wheel = _wheel(model, joint, link, points, axis) if abs(axis @ down) < 1.0 - _DOWN else None
    if wheel is not None:
        return wheel
    # the flat side of a shank above a ball is not a sole
    of_link = [some for each, some in zip(own, shapes, strict=True) if each.parentFrame == frame]
    normal = _face(np.vstack(of_link), down)
    if normal is not None:
        sole = _sole(own, joint, link, _plane(points, normal, upward.rotation[:, 0]))
        if sole is not None:
            return sole
    geometry, placement = own[lowest].geometry, own[lowest].placement
    if isinstance(geometry, coal.Sphere) and geometry.radius > 0.0:
        centre, radius, measured_on = placement.translation, float(geometry.radius), "the sphere in the URDF"
    else:
        ball = _ball(shapes[lowest], down)
        tip = points[np.argmax(points @ down)]
        centre, radius = ball if ball is not None else (tip - UNKNOWN_RADIUS * down, UNKNOWN_RADIUS)
        measured_on = "a sphere fitted to the foot's underside" if ball is not None else ""
    return Foot(joint, link, "point", pin.SE3(np.eye(3), centre), radius=radius, measured_on=measured_on)


def _wheel(model: RobotModel, joint: int, link: str, points: Array, axis: Array) -> Foot | None:
    own = model.pinocchio.joints[joint]
    lower, upper = model.pinocchio.lowerPositionLimit[own.idx_q], model.pinocchio.upperPositionLimit[own.idx_q]
    if not (own.nq == 2 or upper - lower > _CONTINUOUS_RANGE):
        return None
    aside = points - np.outer(points @ axis, axis)
    radii = np.linalg.norm(aside, axis=1)
    first = aside[np.argmax(radii)] / radii.max()
    sector = np.floor(np.arctan2(aside @ np.cross(axis, first), aside @ first) / (2.0 * np.pi) * _SECTORS).astype(int)
    rim = [float(radii[sector == i].max(initial=0.0)) for i in range(-_SECTORS // 2, _SECTORS // 2)]
    if not (min(rim) >= _ROUND * max(rim)):
        return None
    outer = points[radii >= _ROUND * radii.max()] @ axis
    centre = 0.5 * (outer.min() + outer.max()) * axis
    placement, radius = pin.SE3(np.eye(3), centre), float(radii.max())
    return Foot(joint, link, "rolling", placement, radius=radius, axis=np.array(axis), measured_on="the wheel's shape")


def _face(points: Array, down: Array) -> Array | None:
    """Return the outward normal of the largest flat face below, (3,); None without a sole-sized face."""
    try:
        hull = ConvexHull(points)
    except QhullError:
        return _flat_face(points, down)
    corners = points[hull.simplices]  # (k, 3, 3)
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    normals = hull.equations[:, :3]
    below = normals @ down > _DOWN
    if not below.any():
        return None
    normals, areas = normals[below], areas[below]
    cosines = normals @ normals.T  # (k, k)
    largest = int(np.argmax((cosines > _ALIKE) @ areas))
    sole = cosines[largest] > _ALIKE
    outline_below = float(areas @ (normals @ down))  # approximate area of the outline seen from below
    if not (areas[sole].sum() >= max(_LEAST_AREA, _LEAST_SHARE * outline_below)):
        return None
    # rounded edges would tilt the normal
    flat = sole & (cosines[int(np.argmax(np.where(sole, (cosines > _FLAT) @ areas, 0.0)))] > _FLAT)
    mean = areas[flat] @ normals[flat]
    return np.asarray(mean / np.linalg.norm(mean))


def _flat_face(points: Array, down: Array) -> Array | None:
    """Return the downward normal of points in a plane, (3,); None for collinear points or a steep plane."""
    around = points - points.mean(axis=0)
    _, sizes, axes = np.linalg.svd(around, full_matrices=False)
    if len(points) < 3 or not (sizes[1] > _LINE * sizes[0]):
        return None
    normal = axes[2] * np.sign(axes[2] @ down)
    return np.asarray(normal) if normal @ down > _DOWN else None


def _plane(points: Array, normal: Array, forward: Array) -> pin.SE3:
    """Return the plane that touches a body from below: z inwards, x forward."""
    z = -normal
    x = forward - (forward @ z) * z
    x /= np.linalg.norm(x)
    return pin.SE3(np.column_stack([x, np.cross(z, x), z]), float((points @ normal).max()) * normal)


def _sole(elements: Sequence[pin.GeometryObject], joint: int, link: str, plane: pin.SE3) -> Foot | None:
    whole = footprint(elements, plane)
    if whole is None or _area(whole.polygon) < _LEAST_AREA:
        return None
    thin = (footprint(elements, plane, layer) for layer in _LAYERS)
    found = next((one for one in thin if one and _area(one.polygon) >= _LAYER_SHARE * _area(whole.polygon)), whole)
    if not (found.size.min() >= _LEAST_SIDE):
        return None
    low, high = found.polygon.min(axis=0), found.polygon.max(axis=0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    placement = plane * pin.SE3(np.eye(3), np.array([*middle, found.height]))
    rectangle = bool(_area(found.polygon) >= _RECTANGLE * np.prod(high - low))
    if rectangle:
        corners = half * np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    else:
        corners = simplify_polygon(found.polygon - middle, _MOST_CORNERS)
    return Foot(joint, link, "surface", placement, corners, rectangle, measured_on="the foot's shape near its sole")


def _area(polygon: Array) -> float:
    after = np.roll(polygon, -1, axis=0)
    return float(0.5 * abs((polygon[:, 0] * after[:, 1] - polygon[:, 1] * after[:, 0]).sum()))


def _ball(points: Array, down: Array) -> tuple[Array, float] | None:
    """Return centre, (3,) in m, and radius of a sphere fitted to the lower side; None if the fit is poor."""
    try:
        hull = ConvexHull(points)
    except QhullError:
        return None
    chosen = np.unique(hull.simplices[hull.equations[:, :3] @ down > _CAP])
    if len(chosen) < 6:
        return None
    ball = fit_sphere(points[chosen])
    if ball is None or not ball[1] < _LARGEST_BALL:
        return None
    centre, radius = ball
    deviations = np.linalg.norm(points[chosen] - centre, axis=1) - radius
    return (centre, radius) if np.abs(deviations).max() <= _BALL * radius else None
