"""Simplified meshes for the browser, with sharp edges."""

import logging
from dataclasses import replace

import coal
import fast_simplification
import numpy as np
import pinocchio as pin
import trimesh

from wbc_controller.controller.visualization.geometry import Part, bones, color_of, hull_of, read_visuals
from wbc_controller.inverse_dynamics.robot.model import RobotModel

#: Approximate number of triangles of a robot; a browser without a GPU draws them a few times per second.
TRIANGLES = 60_000
_MIN_TRIANGLES = 200  # not simplified below
_AGGRESSIVENESS = 3  # 0 to 10; larger values separate parts at their edges
_SHARP = 0.6  # smallest angle between two triangles with a sharp edge, rad
_MERGE_DISTANCE = 1.0e-5  # m


def build_meshes(model: RobotModel) -> list[Part]:
    """Return meshes of about `TRIANGLES` triangles; raise `ConfigurationError` for unreadable geometry."""
    visuals, bare = read_visuals(model)
    counts = [each.geometry.num_tris if isinstance(each.geometry, coal.BVHModelBase) else 0 for each in visuals]
    share = min(1.0, TRIANGLES / max(1, sum(counts)))
    parts = list(map(_simplified, visuals, [max(_MIN_TRIANGLES, int(share * count)) for count in counts]))
    for joint in set(bare) - {part.joint for part in parts}:
        parts += bones(model, joint)
    return [_with_sharp_edges(part) for part in parts]


def _simplified(visual: pin.GeometryObject, most: int) -> Part:
    shape = visual.geometry
    if not isinstance(shape, coal.BVHModelBase):
        return hull_of(visual)
    points = np.array(shape.vertices(), dtype=np.float64)
    corners = np.array([(t[0], t[1], t[2]) for t in map(shape.tri_indices, range(shape.num_tris))])
    _, first, same = np.unique(np.round(points / _MERGE_DISTANCE), axis=0, return_index=True, return_inverse=True)
    points, corners = points[first], same.reshape(-1)[corners]
    if len(corners) > most:
        points, corners = fast_simplification.simplify(
            points.astype(np.float32), corners, target_count=most, agg=_AGGRESSIVENESS
        )
    placed = points @ visual.placement.rotation.T + visual.placement.translation
    return Part(str(visual.name), int(visual.parentJoint), placed, corners, color_of(visual))


def _with_sharp_edges(part: Part) -> Part:
    """Give both sides of a sharp edge their own vertices, because a browser smooths shared ones."""
    mesh = trimesh.Trimesh(part.vertices, part.triangles, process=False)
    mesh.update_faces(mesh.nondegenerate_faces())
    smooth = trimesh.graph.smooth_shade(mesh, angle=_SHARP)
    return replace(part, vertices=np.asarray(smooth.vertices), triangles=np.asarray(smooth.faces))


logging.getLogger("trimesh").setLevel(logging.WARNING)
