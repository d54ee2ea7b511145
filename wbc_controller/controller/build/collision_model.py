"""Builds the collision model from URDF and SRDF: the links' shapes, and the pairs of links to keep apart."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull, QhullError

from wbc_controller.controller.build.collision_elements import enclosing_points, read_collision_elements
from wbc_controller.errors import ConfigurationError, valid_choices
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.robot.urdf import parse_xml
from wbc_controller.records import Array

#: Smallest side of a box that takes the place of a hull, and thickness below which points have none, m.
_THINNEST = 1.0e-4
#: Number of directions in which the extremes points are taken: fewer than the neighbours that a corner may have.
_DIRECTIONS = 250
#: Largest distance by which a hull may be smaller than its points, m.
_LARGEST_LOSS = 1.0e-3


@dataclass(frozen=True, slots=True)
class CollisionModel:
    """Convex shapes, one for each link that has collision elements, and the pairs to keep apart.

    Attributes:
        geometry: shapes, named after their links, and pairs.
        near: pairs of links that are nearer than the margin in the nominal posture, and so are left out.
        replaced: links whose elements have no convex hull that can be used, and so count as a box around them.
    """

    geometry: pin.GeometryModel
    near: tuple[tuple[str, str], ...]
    replaced: tuple[str, ...] = ()

    @property
    def summary(self) -> str:
        """One readable line: the number of pairs kept apart, and the pairs left out."""
        text = f"{len(self.geometry.collisionPairs)} pairs of {len(self.geometry.geometryObjects)} links kept apart"
        if self.near:
            text += "; not those nearer than the margin in robot.posture: " + ", ".join(map("/".join, self.near))
        if self.replaced:
            text += f"; a box in place of the mesh of {', '.join(self.replaced)}, which has no usable convex hull"
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
    """Read the collision elements of a robot's URDF.

    A link with a single, convex collision element has that shape; any other link has the convex hull of all its
    elements, or a box around them where there is no usable hull. By default all pairs of links are kept apart, except:
    links connected by one or two joints (they touch by design, and their joint limits keep them apart), pairs that the
    SRDF disables, and pairs nearer than the margin in the nominal posture. Links of no such pair need no shape.

    Args:
        margin: smallest distance, m.
        srdf: the SRDF's text.
        pairs: the pairs to keep apart, each ``<link>/<link>``; empty for the default above.
        visual: links whose visual elements serve as collision elements too.
        folder: folder of meshes that are named by a relative path.

    Raises:
        ConfigurationError: if the URDF has no collision elements, a mesh or the SRDF cannot be read, a named link has
            no shape, a named pair is nearer than the margin, or no pair is left.
    """
    elements = read_collision_elements(model, with_visuals(model.urdf, visual), "limits.self_collision", folder)
    joints = {model.pinocchio.frames[frame].name: model.pinocchio.frames[frame].parentJoint for frame in elements}
    every = list(joints)
    if not every:
        raise ConfigurationError(
            "limits.self_collision.enabled: no link of the URDF has a <collision> element; disable it, or add them"
        )
    if pairs:
        chosen = {_parse_pair(pair, every) for pair in pairs}
    else:
        disabled = _disabled_pairs(srdf) if srdf else set()
        chosen = {pair for pair in combinations(every, 2) if frozenset(pair) not in disabled}
        chosen -= {(a, b) for a, b in chosen if _are_connected(model, joints[a], joints[b])}
    needed = {link for pair in chosen for link in pair}
    geometry, replaced = _shapes(model, {frame: own for frame, own in elements.items()
                                         if model.pinocchio.frames[frame].name in needed})  # fmt: skip
    links = [shape.name for shape in geometry.geometryObjects]
    for first, second in combinations(links, 2):
        if (first, second) in chosen or (second, first) in chosen:
            geometry.addCollisionPair(pin.CollisionPair(links.index(first), links.index(second)))
    near = _remove_near_pairs(model, geometry, margin)
    if pairs and near:
        raise ConfigurationError(
            f"limits.self_collision.pairs: in robot.posture {'/'.join(near[0])} are nearer than {margin:g} m"
        )
    if not len(geometry.collisionPairs):
        raise ConfigurationError("limits.self_collision: no pair of links is left to be kept apart")
    return CollisionModel(geometry, near, replaced)


def with_visuals(urdf: str, links: Sequence[str]) -> str:
    """Return the URDF with the visual elements of some links turned into collision elements."""
    if not links:
        return urdf
    root = ElementTree.fromstring(urdf)  # noqa: S314  # the user's own file, already read by Pinocchio
    found = {str(link.get("name")): link.findall("visual") for link in root.iter("link")}
    seen = [name for name, elements in found.items() if elements]
    for name in links:
        if name not in seen:
            raise ConfigurationError(
                f"limits.self_collision.visual: {name!r} is not a link with a visual element; "
                f"{valid_choices(name, seen)}"
            )
        for element in found[name]:
            element.tag = "collision"
    return ElementTree.tostring(root, encoding="unicode")


def _shapes(
    model: RobotModel, elements: Mapping[int, Sequence[pin.GeometryObject]]
) -> tuple[pin.GeometryModel, tuple[str, ...]]:
    """Make one convex shape for each link, and name those that have a box in place of their hull."""
    geometry, replaced = pin.GeometryModel(), []
    for frame_id, own in elements.items():
        frame = model.pinocchio.frames[frame_id]
        if len(own) == 1 and isinstance(own[0].geometry, coal.ShapeBase):
            shape, placement = own[0].geometry, own[0].placement
        else:
            points = np.vstack([enclosing_points(element) for element in own])
            middle = 0.5 * (points.min(axis=0) + points.max(axis=0))  # the limit expects a shape's centre at its origin
            shape, placement = _hull(points - middle), pin.SE3(np.eye(3), middle)
            if shape is None:
                shape = coal.Box(*np.maximum(np.ptp(points, axis=0), _THINNEST))
                replaced.append(frame.name)
        geometry.addGeometryObject(pin.GeometryObject(frame.name, frame.parentJoint, frame_id, placement, shape))
    return geometry, tuple(replaced)


def _hull(points: Array) -> coal.ConvexBase | None:
    """The convex hull of points, (n, 3) in m; None where there is none that keeps distances.

    Points that are nearly on one face can be more than Qhull resolves, and the library allows a corner few neighbours:
    fewer points, which lose little, then take their place.
    """
    if not (np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[-1] > _THINNEST):
        return None  # flat: the library does not survive it
    hull = _convex(np.unique(points, axis=0))
    if hull is None and _distance_outside_hull(points, extremes := _extreme_points(points)) <= _LARGEST_LOSS:
        hull = _convex(extremes)
    return hull


def _convex(corners: Array) -> coal.ConvexBase | None:
    """The convex hull of points, (n, 3) in m; None where Qhull, or the library, does not make it."""
    vertices = coal.StdVec_Vec3s()
    vertices.extend(list(corners))
    try:
        return coal.Convex.convexHull(vertices, True, "Qt")
    except (ValueError, RuntimeError):
        return None


def _extreme_points(points: Array) -> Array:
    """The points that are furthest out in directions all around, (k, 3)."""
    number = np.arange(_DIRECTIONS) + 0.5
    z, turn = 1.0 - 2.0 * number / _DIRECTIONS, np.pi * (1.0 + np.sqrt(5.0)) * number
    across = np.sqrt(1.0 - z**2)
    directions = np.column_stack([across * np.cos(turn), across * np.sin(turn), z])
    return np.asarray(points[np.unique(np.argmax(directions @ points.T, axis=1))])


def _distance_outside_hull(points: Array, corners: Array) -> float:
    """Largest distance of points beyond the faces of the hull of some of them, m."""
    try:
        faces = ConvexHull(corners).equations
    except QhullError:
        return np.inf
    return float((faces[:, :3] @ points.T + faces[:, 3:]).max())


def _are_connected(model: RobotModel, a: int, b: int) -> bool:
    """Whether two joints move one body, or are connected by one or two joints in series."""
    parents = model.pinocchio.parents
    carriers = [(link, parents[link], parents[parents[link]]) for link in (a, b)]
    return bool(b in carriers[0] or a in carriers[1])


def _parse_pair(pair: str, links: Sequence[str]) -> tuple[str, str]:
    first, _, second = pair.partition("/")
    for link in (first, second):
        if link not in links:
            raise ConfigurationError(
                f"limits.self_collision.pairs: {pair!r}: {link!r} is not a link with a collision element; "
                f"{valid_choices(link, links)}"
            )
    if first == second:
        raise ConfigurationError(f"limits.self_collision.pairs: {pair!r} pairs a link with itself")
    return first, second


def _disabled_pairs(srdf: str) -> set[frozenset[str]]:
    """Pairs of links whose collisions an SRDF disables."""
    root = parse_xml(srdf, "limits.self_collision.srdf", "SRDF")
    return {
        frozenset((element.get("link1", ""), element.get("link2", ""))) for element in root.iter("disable_collisions")
    }


def _remove_near_pairs(model: RobotModel, geometry: pin.GeometryModel, margin: float) -> tuple[tuple[str, str], ...]:
    """Remove the pairs that are nearer than the margin in the nominal posture, and return their names."""
    data, placements = model.pinocchio.createData(), geometry.createData()
    pin.updateGeometryPlacements(model.pinocchio, data, geometry, placements, model.configuration(model.posture))
    every = [(pair.first, pair.second) for pair in geometry.collisionPairs]  # numbers, since the pairs are views
    near = [
        pair
        for i, pair in enumerate(every)
        if not (pin.computeDistance(geometry, placements, i).min_distance >= margin)
    ]
    for first, second in near:
        geometry.removeCollisionPair(pin.CollisionPair(first, second))
    return tuple((geometry.geometryObjects[i].name, geometry.geometryObjects[j].name) for i, j in near)
