"""Simplified meshes for the browser, with sharp edges."""

import logging
from dataclasses import dataclass

import coal
import fast_simplification
import numpy as np
import numpy.typing as npt
import pinocchio as pin
import trimesh

from wbc_controller.controller.visualization.geometry import GREY, bones, color_of, hull_of, read_visuals
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array

#: Approximate number of triangles of a robot; a browser without a GPU draws them a few times per second.
TRIANGLES = 60_000
_MIN_TRIANGLES = 200  # not simplified below
_AGGRESSIVENESS = 3  # 0 to 10; larger values separate parts at their edges
_SHARP = 0.6  # smallest angle between two triangles with a sharp edge, rad
_MERGE_DISTANCE = 1.0e-5  # m


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """A mesh of one joint."""

    name: str
    joint: int  # index of the joint in `RobotModel.pinocchio`; 0 for the world
    vertices: npt.NDArray[np.float32]  # in the joint's frame, (n, 3) in m
    triangles: npt.NDArray[np.uint32]  # vertex indices of each triangle, (m, 3)
    color: tuple[float, float, float]  # red, green and blue, 0 to 1


def build_meshes(model: RobotModel) -> list[Mesh]:
    """Return meshes of about `TRIANGLES` triangles; raise `ConfigurationError` for unreadable geometry."""
    visuals, bare = read_visuals(model)
    counts = [each.geometry.num_tris if isinstance(each.geometry, coal.BVHModelBase) else 0 for each in visuals]
    share = min(1.0, TRIANGLES / max(1, sum(counts)))
    found = [
        _mesh(visual, max(_MIN_TRIANGLES, int(share * count))) for visual, count in zip(visuals, counts, strict=True)
    ]
    for joint in set(bare) - {mesh.joint for mesh in found}:
        for part in bones(model, joint):
            found.append(Mesh(part.name, part.joint, *_split_sharp_edges(part.vertices, part.triangles), GREY))
    return found


def _mesh(visual: pin.GeometryObject, most: int) -> Mesh:
    shape, color = visual.geometry, color_of(visual)
    if not isinstance(shape, coal.BVHModelBase):
        part = hull_of(visual)
        return Mesh(part.name, part.joint, *_split_sharp_edges(part.vertices, part.triangles), color)
    points = np.array(shape.vertices(), dtype=np.float64)
    corners = np.array([(t[0], t[1], t[2]) for t in map(shape.tri_indices, range(shape.num_tris))])
    _, first, same = np.unique(np.round(points / _MERGE_DISTANCE), axis=0, return_index=True, return_inverse=True)
    points, corners = points[first], same.reshape(-1)[corners]
    if len(corners) > most:
        points, corners = fast_simplification.simplify(
            points.astype(np.float32), corners, target_count=most, agg=_AGGRESSIVENESS
        )
    placed = points @ visual.placement.rotation.T + visual.placement.translation
    return Mesh(str(visual.name), int(visual.parentJoint), *_split_sharp_edges(placed, corners), color)


def _split_sharp_edges(
    points: Array, corners: npt.NDArray[np.intp]
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint32]]:
    """Give both sides of a sharp edge their own vertices, because a browser smooths shared ones."""
    mesh = trimesh.Trimesh(points, corners, process=False)
    mesh.update_faces(mesh.nondegenerate_faces())
    smooth = trimesh.graph.smooth_shade(mesh, angle=_SHARP)
    return np.asarray(smooth.vertices, dtype=np.float32), np.asarray(smooth.faces, dtype=np.uint32)


logging.getLogger("trimesh").setLevel(logging.WARNING)
