"""The robot's meshes as a browser draws them: few enough triangles for one without a GPU, and edges that stay sharp."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import coal
import fast_simplification
import numpy as np
import numpy.typing as npt
import trimesh

from wbc_controller.controller.visualization.geometry import GREY, Visual, bones, hull_of, read_visuals
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array

#: Approximate number of triangles of a robot; a browser without a GPU draws them a few times a second.
TRIANGLES = 60_000
#: Number of triangles below which a mesh is not simplified.
_FEWEST = 200
#: How fast triangles are removed, from 0 to 10: with less care, parts come apart at their edges.
_CAREFUL = 3
#: Smallest angle between two triangles whose edge is drawn sharp, rad.
_SHARP = 0.6
#: Distance below which vertices are merged, m: a file of triangles has each of its corners several times.
_SAME = 1.0e-5


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """A mesh that moves with one joint."""

    name: str
    joint: int  # index of the joint of `RobotModel.pinocchio` that moves it; 0 for the world
    vertices: npt.NDArray[np.float32]  # in the joint's frame, (n, 3) in m
    triangles: npt.NDArray[np.uint32]  # indices of the vertices of each triangle, (m, 3)
    color: tuple[float, float, float]  # red, green and blue from 0 to 1


def build_meshes(model: RobotModel, most: int = TRIANGLES) -> list[Mesh]:
    """Build the meshes of a robot, together with about `most` triangles: a mesh of many separate shells stays larger.

    Raises:
        ConfigurationError: if the visual geometry of the URDF cannot be read.
    """
    visuals, bare = read_visuals(model)
    counts = [visual.shape.num_tris if isinstance(visual.shape, coal.BVHModelBase) else 0 for visual in visuals]
    share = min(1.0, most / max(1, sum(counts)))
    meshes = [_mesh(visual, max(_FEWEST, int(share * count))) for visual, count in zip(visuals, counts, strict=True)]
    found = [mesh for mesh in meshes if mesh is not None]
    for joint in set(bare) - {mesh.joint for mesh in found}:
        for part in bones(model, joint):
            found.append(Mesh(part.name, part.joint, *_drawn(part.vertices, part.triangles), GREY))
    return found


def _mesh(visual: Visual, most: int) -> Mesh | None:
    color = visual.color or GREY
    if not isinstance(visual.shape, coal.BVHModelBase):
        part = hull_of(visual)
        return None if part is None else Mesh(part.name, part.joint, *_drawn(part.vertices, part.triangles), color)
    points = np.array(visual.shape.vertices(), dtype=np.float64)
    corners = np.array([(t[0], t[1], t[2]) for t in map(visual.shape.tri_indices, range(visual.shape.num_tris))])
    _, first, same = np.unique(np.round(points / _SAME), axis=0, return_index=True, return_inverse=True)
    points, corners = points[first], same.reshape(-1)[corners]
    if len(corners) > most:
        points, corners = fast_simplification.simplify(
            points.astype(np.float32), corners, target_count=most, agg=_CAREFUL
        )
    placed = points @ visual.placement.rotation.T + visual.placement.translation
    return Mesh(visual.name, visual.joint, *_drawn(placed, corners), color)


def _drawn(points: Array, corners: npt.NDArray[np.intp]) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint32]]:
    """Give each side of a sharp edge its own vertices, since a browser smooths shared ones."""
    mesh = trimesh.Trimesh(points, corners, process=False)
    mesh.update_faces(mesh.nondegenerate_faces())
    smooth = trimesh.graph.smooth_shade(mesh, angle=_SHARP)
    return np.asarray(smooth.vertices, dtype=np.float32), np.asarray(smooth.faces, dtype=np.uint32)


logging.getLogger("trimesh").setLevel(logging.WARNING)
