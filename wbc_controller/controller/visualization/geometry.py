"""Visual geometry of the URDF."""

import logging
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pinocchio as pin
from scipy.spatial import ConvexHull, QhullError

from wbc_controller.controller.build.collision_elements import mesh_packages
from wbc_controller.controller.build.footprint import outline
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array, frozen
from wbc_controller.settings.resources import PACKAGE_SCHEME, share_folder

logger = logging.getLogger(__name__)

TRIANGLES = 120  # largest number of triangles of a hull; a hull of n corners has 2n - 4
TOLERANCE = 2.0e-4  # largest distance of omitted corners outside the hull, m
BONE = 0.03  # thickness of bars in place of missing meshes, m
BADGE = 0.015  # parts that protrude less from another part of the joint, m, are omitted
GREY = (0.62, 0.64, 0.67)  # default color, red, green and blue


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Convex body moved by one joint."""

    name: str
    joint: int  # joint number in `RobotModel.pinocchio`; 0 for the world
    vertices: Array  # in the joint's frame, (n, 3) in m
    triangles: npt.NDArray[np.intp]  # corners of each triangle, counter-clockwise seen from outside, (m, 3)
    color: tuple[float, float, float]  # red, green and blue from 0 to 1


def read_visuals(model: RobotModel) -> tuple[list[pin.GeometryObject], tuple[int, ...]]:
    """Return the visuals of a robot, placed in the joint's frame, and joints of links with missing meshes (logged).

    `ConfigurationError` if the visual geometry is invalid.
    """
    folders = []
    for package in mesh_packages(model.urdf):
        try:
            folders.append(share_folder(package).parent)
        except ConfigurationError as error:
            logger.warning("%s", error)
    urdf, bare_links = _without_missing_meshes(model.urdf, folders)
    robot = model.pinocchio
    try:
        geometry = pin.buildGeomFromUrdfString(
            robot, urdf, pin.VISUAL, package_dirs=[str(folder) for folder in folders]
        )
    except (ValueError, RuntimeError) as error:
        raise ConfigurationError(f"robot.urdf: invalid visual geometry: {error}") from error
    bare = {int(robot.frames[robot.getFrameId(link, pin.BODY)].parentJoint) for link in bare_links}
    return list(geometry.geometryObjects), tuple(sorted(bare))


def color_of(visual: pin.GeometryObject) -> tuple[float, float, float]:
    """Return red, green and blue of a visual, from 0 to 1; `GREY` without a color in the URDF."""
    red, green, blue = np.clip(visual.meshColor[:3], 0.0, 1.0).tolist()
    return (red, green, blue) if visual.overrideMaterial else GREY


def build_parts(model: RobotModel) -> tuple[Part, ...]:
    """Build the simplified parts of a robot, with bars for missing meshes; errors as in `read_visuals`."""
    visuals, bare = read_visuals(model)
    parts = [hull_of(visual) for visual in visuals]
    parts = [part for part in parts if not any(_embedded(part, other) for other in parts)]
    for joint in sorted(set(bare) - {part.joint for part in parts}):
        parts += bones(model, joint)
    return tuple(parts)


def hull_of(visual: pin.GeometryObject) -> Part:
    """Return the convex hull of a visual."""
    return Part(str(visual.name), int(visual.parentJoint), *convex_hull(outline(visual)), color_of(visual))


def convex_hull(points: Array, triangles: int = TRIANGLES) -> tuple[Array, npt.NDArray[np.intp]]:
    """Approximate the convex hull of points, (n, 3) in m, by corners, (c, 3), and triangles as in `Part`."""
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
    index = np.empty(len(chosen), dtype=np.intp)
    index[hull.vertices] = np.arange(len(hull.vertices))
    faces = hull.simplices.astype(np.intp)
    a, b, c = (candidates[chosen][faces[:, i]] for i in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return frozen(candidates[chosen][hull.vertices]), index[faces]


def _embedded(part: Part, other: Part) -> bool:
    if part is other or part.joint != other.joint:
        return False
    equations = ConvexHull(other.vertices).equations
    outside = (part.vertices @ equations[:, :3].T + equations[:, 3]).max()
    # Of two similar parts the larger one is kept.
    return bool(outside < BADGE and ConvexHull(part.vertices).volume < ConvexHull(other.vertices).volume)


def _without_missing_meshes(urdf: str, folders: list[Path]) -> tuple[str, list[str]]:
    root = ElementTree.fromstring(urdf)  # noqa: S314 - checked
    bare = []
    for link in root.iter("link"):
        for visual in link.findall("visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is None:
                continue
            uri = mesh.get("filename", "")
            in_package, path = uri.startswith(PACKAGE_SCHEME), uri.removeprefix(PACKAGE_SCHEME).removeprefix("file://")
            if any((folder / path).is_file() for folder in (folders if in_package else [Path()])):
                continue
            logger.warning("link %r: mesh %s does not exist; drawn as a bar", link.get("name"), uri)
            link.remove(visual)
            bare.append(link.get("name", ""))
    return ElementTree.tostring(root, encoding="unicode"), bare


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
