"""Visual geometry of the URDF."""

from __future__ import annotations

import logging
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import coal
import numpy as np
import numpy.typing as npt
import pinocchio as pin
from scipy.spatial import ConvexHull, QhullError

from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array, frozen
from wbc_controller.settings.resources import PACKAGE_SCHEME, share_folder

logger = logging.getLogger(__name__)

#: Largest number of triangles of a hull. A hull of n corners has 2n - 4 triangles.
TRIANGLES = 120
#: Largest distance of omitted corners outside the hull, m.
TOLERANCE = 2.0e-4
#: Thickness of bars in place of missing meshes, m.
BONE = 0.03

#: Parts that protrude less from another part of the joint, m, are omitted.
BADGE = 0.015

#: Default color, red, green and blue.
GREY = (0.62, 0.64, 0.67)


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Convex body moved by one joint."""

    name: str
    joint: int  # joint number in `RobotModel.pinocchio`; 0 for the world
    vertices: Array  # in the joint's frame, (n, 3) in m
    #: Corners of each triangle, counter-clockwise seen from outside, (m, 3).
    triangles: npt.NDArray[np.intp]
    color: tuple[float, float, float]  # red, green and blue from 0 to 1


@dataclass(frozen=True, slots=True, eq=False)
class Visual:
    """Visual of the URDF."""

    name: str
    joint: int  # as in `Part`
    placement: pin.SE3  # shape in the joint's frame
    shape: coal.CollisionGeometry
    color: tuple[float, float, float] | None  # as in `Part`; None without a color in the URDF


def read_visuals(model: RobotModel) -> tuple[tuple[Visual, ...], tuple[int, ...]]:
    """Return the visuals of a robot, and joints of links with missing meshes (logged).

    Raises:
        ConfigurationError: if the visual geometry is invalid.
    """
    folders = _package_folders(model.urdf)
    urdf, bare_links = _without_missing_meshes(model.urdf, folders)
    try:
        geometry = pin.buildGeomFromUrdfString(
            model.pinocchio, urdf, pin.VISUAL, package_dirs=[str(folder) for folder in folders]
        )
    except (ValueError, RuntimeError) as error:
        raise ConfigurationError(f"robot.urdf: invalid visual geometry: {error}") from error
    visuals = []
    for item in geometry.geometryObjects:
        red, green, blue = np.clip(item.meshColor[:3], 0.0, 1.0)
        color = (float(red), float(green), float(blue)) if item.overrideMaterial else None
        visuals.append(Visual(str(item.name), int(item.parentJoint), item.placement, item.geometry, color))
    return tuple(visuals), tuple(sorted({_joint_of(model, link) for link in bare_links}))


def build_parts(model: RobotModel) -> tuple[Part, ...]:
    """Build the simplified parts of a robot, with bars for missing meshes; errors as in `read_visuals`."""
    visuals, bare = read_visuals(model)
    parts = [part for part in map(hull_of, visuals) if part is not None]
    parts = [part for part in parts if not any(_embedded(part, other) for other in parts)]
    drawn = {part.joint for part in parts}
    for joint in bare:
        if joint not in drawn:
            parts.extend(bones(model, joint))
    return tuple(parts)


def hull_of(visual: Visual) -> Part | None:
    """Return the convex hull of a visual; None, with a warning, for unsupported shapes."""
    points = _points(visual.shape)
    if points is None:
        logger.warning("%s: a %s cannot be drawn", visual.name, type(visual.shape).__name__)
        return None
    placed = points @ visual.placement.rotation.T + visual.placement.translation
    return Part(visual.name, visual.joint, *convex_hull(placed), visual.color or GREY)


def convex_hull(points: Array, triangles: int = TRIANGLES) -> tuple[Array, npt.NDArray[np.intp]]:
    """Approximate the convex hull of points, (n, 3) in m.

    Returns:
        Corners, (c, 3), and corner indices of each triangle, counter-clockwise seen from outside.
    """
    try:
        candidates = points[ConvexHull(points).vertices]
    except QhullError:
        # Flat: bounding box of at least 1 mm.
        center, half = (points.max(0) + points.min(0)) / 2.0, np.maximum(np.ptp(points, axis=0) / 2.0, 5.0e-4)
        candidates = center + half * np.array(list(product((-1.0, 1.0), repeat=3)))
    directions = np.vstack([np.eye(3), -np.eye(3), list(product((-1.0, 1.0), repeat=3))])
    chosen = list(dict.fromkeys(np.argmax(candidates @ directions.T, axis=0).tolist()))
    while len(chosen) < min((triangles + 4) // 2, len(candidates)):
        equations = ConvexHull(candidates[chosen]).equations  # (facets, 4): outward normal and offset
        outside = (candidates @ equations[:, :3].T + equations[:, 3]).max(axis=1)  # (candidates,)
        farthest = int(np.argmax(outside))
        if outside[farthest] < TOLERANCE:
            break
        chosen.append(farthest)
    hull = ConvexHull(candidates[chosen])
    corners = candidates[chosen][hull.vertices]
    index = np.empty(len(chosen), dtype=np.intp)
    index[hull.vertices] = np.arange(len(hull.vertices))
    faces = hull.simplices.astype(np.intp)
    a, b, c = (candidates[chosen][faces[:, i]] for i in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return frozen(corners), index[faces]


def _points(shape: coal.CollisionGeometry) -> Array | None:
    corners = np.array(list(product((-1.0, 1.0), repeat=3)))
    angles = np.arange(20) * 2.0 * np.pi / 20
    ring = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(20)])
    if isinstance(shape, coal.Box):
        return np.asarray(corners * shape.halfSide)
    if isinstance(shape, coal.Sphere):
        return float(shape.radius) * _sphere()
    if isinstance(shape, coal.Cylinder):
        top = np.array([0.0, 0.0, shape.halfLength])
        return np.vstack([shape.radius * ring + top, shape.radius * ring - top])
    if isinstance(shape, coal.Capsule):
        top = np.array([0.0, 0.0, shape.halfLength])
        return np.vstack([shape.radius * _sphere() + top, shape.radius * _sphere() - top])
    if isinstance(shape, coal.BVHModelBase):
        return np.array(shape.vertices(), dtype=np.float64)
    return None


def _embedded(part: Part, other: Part) -> bool:
    if part is other or part.joint != other.joint:
        return False
    equations = ConvexHull(other.vertices).equations
    outside = (part.vertices @ equations[:, :3].T + equations[:, 3]).max()
    # Of two similar parts the larger one is kept.
    return bool(outside < BADGE and ConvexHull(part.vertices).volume < ConvexHull(other.vertices).volume)


def _sphere() -> Array:
    k = np.arange(54)
    z = 1.0 - (2.0 * k + 1.0) / 54
    angle = k * np.pi * (3.0 - np.sqrt(5.0))
    radius = np.sqrt(1.0 - z**2)
    return np.vstack([np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z]), np.eye(3), -np.eye(3)])


def _package_folders(urdf: str) -> list[Path]:
    folders = []
    for package in sorted(set(re.findall(re.escape(PACKAGE_SCHEME) + r"([^/\"']+)/", urdf))):
        try:
            folders.append(share_folder(package).parent)
        except ConfigurationError as error:
            logger.warning("%s", error)
    return folders


def _without_missing_meshes(urdf: str, folders: list[Path]) -> tuple[str, list[str]]:
    root = ElementTree.fromstring(urdf)  # noqa: S314 - checked
    bare = []
    for link in root.iter("link"):
        for visual in link.findall("visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is None:
                continue
            uri = mesh.get("filename", "")
            if _mesh_exists(uri, folders):
                continue
            logger.warning("link %r: mesh %s does not exist; drawn as a bar", link.get("name"), uri)
            link.remove(visual)
            bare.append(link.get("name", ""))
    return ElementTree.tostring(root, encoding="unicode"), bare


def _mesh_exists(uri: str, folders: list[Path]) -> bool:
    if uri.startswith(PACKAGE_SCHEME):
        return any((folder / uri.removeprefix(PACKAGE_SCHEME)).is_file() for folder in folders)
    return Path(uri.removeprefix("file://")).is_file()


def _joint_of(model: RobotModel, link: str) -> int:
    return int(model.pinocchio.frames[model.pinocchio.getFrameId(link, pin.BODY)].parentJoint)


def bones(model: RobotModel, joint: int) -> list[Part]:
    """Return a cube at a joint and a bar to each of its child joints."""
    robot = model.pinocchio
    name = str(robot.names[joint])
    cube = BONE * np.array(list(product((-1.0, 1.0), repeat=3)))
    parts = [Part(f"{name}_knob", joint, *convex_hull(cube), GREY)]
    for child in range(joint + 1, robot.njoints):
        if robot.parents[child] == joint:
            ends = np.vstack([0.4 * cube, 0.4 * cube + robot.jointPlacements[child].translation])
            parts.append(Part(f"{name}_to_{robot.names[child]}", joint, *convex_hull(ends), GREY))
    return parts
