"""Collision model from URDF and SRDF."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, groupby
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull, QhullError

from wbc_controller.controller.build.collision_elements import enclosing_points, read_collision_elements
from wbc_controller.errors import ConfigurationError, require_known
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.robot.urdf import parse_xml
from wbc_controller.records import Array

_THINNEST = 1.0e-4  # smallest side of a box in place of a hull, and smallest thickness of a hull, m
_DIRECTIONS = 250  # directions of extreme points; below Coal's largest number of neighbours of a corner
_LARGEST_LOSS = 1.0e-3  # largest distance of points outside a simplified hull, m


@dataclass(frozen=True, slots=True)
class CollisionModel:
    """Convex shapes of links, and the pairs to keep apart."""

    geometry: pin.GeometryModel  # shapes, named after their links, and pairs
    near: tuple[tuple[str, str], ...]  # excluded pairs, nearer than the margin in the nominal posture
    replaced: tuple[str, ...] = ()  # links with a bounding box in place of a hull

    @property
    def summary(self) -> str:
        """Number of pairs, excluded pairs and replaced hulls in one line."""
        text = f"{len(self.geometry.collisionPairs)} pairs of {len(self.geometry.geometryObjects)} links kept apart"
        if self.near:
            text += "; excluded, nearer than the margin in robot.posture: " + ", ".join(map("/".join, self.near))
        if self.replaced:
            text += f"; bounding box in place of an unusable convex hull: {', '.join(self.replaced)}"
        return text


def build_collision_model(
    model: RobotModel,
    *,
    margin: float,
    srdf: str | None = None,
    pairs: Sequence[str] = (),
    visual: Sequence[str] = (),
    folder: Path | None = None,
) -> CollisionModel:
    """Build the collision model of a robot; docs/limits.md describes the shapes and the default pairs.

    `margin` is the smallest distance, m; `pairs` are ``<link>/<link>``, empty for the default; `visual` names links
    with visual as collision elements; `folder` is that of relative mesh paths.
    """
    elements = read_collision_elements(model, with_visuals(model.urdf, visual), "limits.self_collision", folder)
    frames = model.pinocchio.frames
    joints = {frames[element.parentFrame].name: element.parentJoint for element in elements}
    every = list(joints)
    if not every:
        raise ConfigurationError(
            "limits.self_collision.enabled: the URDF has no <collision> elements; add them, or disable self-collision"
        )
    if pairs:
        chosen = {_parse_pair(pair, every) for pair in pairs}
    else:
        root = parse_xml(srdf, "limits.self_collision.srdf", "SRDF") if srdf else ElementTree.Element("robot")
        disabled = {frozenset((each.get("link1"), each.get("link2"))) for each in root.iter("disable_collisions")}
        chosen = {pair for pair in combinations(every, 2) if frozenset(pair) not in disabled}
        parents = model.pinocchio.parents
        near_joints = {link: (j, parents[j], parents[parents[j]]) for link, j in joints.items()}
        chosen -= {(a, b) for a, b in chosen if joints[a] in near_joints[b] or joints[b] in near_joints[a]}
    needed = {link for pair in chosen for link in pair}
    geometry, replaced = _shapes(model, [each for each in elements if frames[each.parentFrame].name in needed])
    links = [shape.name for shape in geometry.geometryObjects]
    for first, second in combinations(links, 2):
        if (first, second) in chosen or (second, first) in chosen:
            geometry.addCollisionPair(pin.CollisionPair(links.index(first), links.index(second)))
    near = _remove_near_pairs(model, geometry, margin)
    if pairs and near:
        raise ConfigurationError(
            f"limits.self_collision.pairs: {'/'.join(near[0])} are nearer than margin = {margin:g} m in robot.posture"
        )
    if not len(geometry.collisionPairs):
        raise ConfigurationError("limits.self_collision: all pairs of links are excluded; name some in pairs")
    return CollisionModel(geometry, near, replaced)


def with_visuals(urdf: str, links: Sequence[str]) -> str:
    """Return the URDF with visual elements of some links converted to collision elements."""
    if not links:
        return urdf
    root = ElementTree.fromstring(urdf)  # noqa: S314 - checked
    found = {str(link.get("name")): link.findall("visual") for link in root.iter("link")}
    seen = [name for name, elements in found.items() if elements]
    require_known(links, seen, "limits.self_collision.visual:", " is not a link with visual elements")
    for name in links:
        for element in found[name]:
            element.tag = "collision"
    return ElementTree.tostring(root, encoding="unicode")


def _shapes(model: RobotModel, elements: Sequence[pin.GeometryObject]) -> tuple[pin.GeometryModel, tuple[str, ...]]:
    geometry, replaced = pin.GeometryModel(), []
    for frame_id, group in groupby(elements, lambda element: element.parentFrame):
        frame, own = model.pinocchio.frames[frame_id], list(group)
        if len(own) == 1 and isinstance(own[0].geometry, coal.ShapeBase):
            shape, placement = own[0].geometry, own[0].placement
        else:
            points = np.vstack([enclosing_points(element) for element in own])
            middle = 0.5 * (points.min(axis=0) + points.max(axis=0))  # for centred shapes
            shape, placement = _hull(points - middle), pin.SE3(np.eye(3), middle)
            if shape is None:
                shape = coal.Box(*np.maximum(np.ptp(points, axis=0), _THINNEST))
                replaced.append(frame.name)
        geometry.addGeometryObject(pin.GeometryObject(frame.name, frame.parentJoint, frame_id, placement, shape))
    return geometry, tuple(replaced)


def _hull(points: Array) -> coal.ConvexBase | None:
    if not (np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[-1] > _THINNEST):
        return None  # Coal crashes with flat hulls
    hull = _convex(np.unique(points, axis=0))
    if hull is None and _distance_outside_hull(points, extremes := _extreme_points(points)) <= _LARGEST_LOSS:
        hull = _convex(extremes)
    return hull


def _convex(corners: Array) -> coal.ConvexBase | None:
    vertices = coal.StdVec_Vec3s()
    vertices.extend(list(corners))
    try:
        return coal.Convex.convexHull(vertices, True, "Qt")
    except (ValueError, RuntimeError):
        return None


def _extreme_points(points: Array) -> Array:
    number = np.arange(_DIRECTIONS) + 0.5
    z, turn = 1.0 - 2.0 * number / _DIRECTIONS, np.pi * (1.0 + np.sqrt(5.0)) * number
    across = np.sqrt(1.0 - z**2)
    directions = np.column_stack([across * np.cos(turn), across * np.sin(turn), z])
    return np.asarray(points[np.unique(np.argmax(directions @ points.T, axis=1))])


def _distance_outside_hull(points: Array, corners: Array) -> float:
    """Return the largest distance of points outside the hull of some of them, m."""
    try:
        faces = ConvexHull(corners).equations
    except QhullError:
        return np.inf
    return float((faces[:, :3] @ points.T + faces[:, 3:]).max())


def _parse_pair(pair: str, links: Sequence[str]) -> tuple[str, str]:
    first, _, second = pair.partition("/")
    key = f"limits.self_collision.pairs: {pair!r}:"
    require_known((first, second), links, key, " is not a link with collision elements")
    if first == second:
        raise ConfigurationError(f"{key} the links must differ")
    return first, second


def _remove_near_pairs(model: RobotModel, geometry: pin.GeometryModel, margin: float) -> tuple[tuple[str, str], ...]:
    data, placements = model.pinocchio.createData(), geometry.createData()
    pin.updateGeometryPlacements(model.pinocchio, data, geometry, placements, model.configuration(model.posture))
    every = [(pair.first, pair.second) for pair in geometry.collisionPairs]  # the pairs are views
    distances = [pin.computeDistance(geometry, placements, i).min_distance for i in range(len(every))]
    near = [pair for pair, distance in zip(every, distances, strict=True) if not (distance >= margin)]
    for first, second in near:
        geometry.removeCollisionPair(pin.CollisionPair(first, second))
    return tuple((geometry.geometryObjects[i].name, geometry.geometryObjects[j].name) for i, j in near)
