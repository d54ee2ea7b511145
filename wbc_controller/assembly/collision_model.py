"""Builds the collision model from URDF and SRDF: the links' shapes, and the pairs of links to keep apart."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

from wbc_controller.assembly.collision_elements import enclosing_points, read_collision_elements
from wbc_controller.core.robot.model import RobotModel
from wbc_controller.core.robot.urdf import parse_xml
from wbc_controller.errors import ConfigurationError, valid_choices
from wbc_controller.records import Array


@dataclass(frozen=True, slots=True)
class CollisionModel:
    """Convex shapes, one for each link that has collision elements, and the pairs to keep apart.

    Attributes:
        geometry: shapes, named after their links, and pairs.
        near: pairs of links that are nearer than the margin in the nominal posture, and so are left out.
    """

    geometry: pin.GeometryModel
    near: tuple[tuple[str, str], ...]

    @property
    def summary(self) -> str:
        """One readable line: the number of pairs kept apart, and the pairs left out."""
        text = f"{len(self.geometry.collisionPairs)} pairs of {len(self.geometry.geometryObjects)} links kept apart"
        if self.near:
            text += "; not those nearer than the margin in robot.posture: " + ", ".join(map("/".join, self.near))
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
    elements. By default all pairs of links are kept apart, except: links connected by one or two joints (they touch by
    design, and their joint limits keep them apart), pairs that the SRDF disables, and pairs nearer than the margin in
    the nominal posture.

    Args:
        model: the robot's model.
        margin: smallest distance, m.
        srdf: the SRDF's text.
        pairs: the pairs to keep apart, each ``<link>/<link>``; empty for the default above.
        visual: links whose visual elements serve as collision elements too.
        folder: folder of meshes that are named by a relative path.

    Raises:
        ConfigurationError: if the URDF has no collision elements, a mesh or the SRDF cannot be read, a named link has
            no shape, a named pair is nearer than the margin, or no pair is left.
    """
    geometry = _shapes(model, with_visuals(model.urdf, visual), folder)
    links = [shape.name for shape in geometry.geometryObjects]
    if not links:
        raise ConfigurationError(
            "limits.self_collision.enabled: no link of the URDF has a <collision> element; disable it, or add them"
        )
    if pairs:
        chosen = {_named(pair, links) for pair in pairs}
    else:
        disabled = _disabled(srdf) if srdf else set()
        chosen = {pair for pair in combinations(links, 2) if frozenset(pair) not in disabled}
        chosen -= {(a, b) for a, b in chosen if _joined(model, geometry, links.index(a), links.index(b))}
    for first, second in combinations(links, 2):
        if (first, second) in chosen or (second, first) in chosen:
            geometry.addCollisionPair(pin.CollisionPair(links.index(first), links.index(second)))
    near = _drop_near(model, geometry, margin)
    if pairs and near:
        raise ConfigurationError(
            f"limits.self_collision.pairs: in robot.posture {'/'.join(near[0])} are nearer than {margin:g} m"
        )
    if not len(geometry.collisionPairs):
        raise ConfigurationError("limits.self_collision: no pair of links is left to be kept apart")
    return CollisionModel(geometry, near)


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


def _shapes(model: RobotModel, urdf: str, folder: Path | None) -> pin.GeometryModel:
    """Make one convex shape for each link with collision elements."""
    elements = read_collision_elements(model, urdf, "limits.self_collision", folder)
    geometry = pin.GeometryModel()
    for frame_id, own in elements.items():
        frame = model.pinocchio.frames[frame_id]
        if len(own) == 1 and isinstance(own[0].geometry, coal.ShapeBase):
            shape, placement = own[0].geometry, own[0].placement
        else:
            points = np.vstack([enclosing_points(element) for element in own])
            middle = 0.5 * (points.min(axis=0) + points.max(axis=0))  # the limit expects a shape's centre at its origin
            shape, placement = _hull(points - middle, frame.name), pin.SE3(np.eye(3), middle)
        geometry.addGeometryObject(pin.GeometryObject(frame.name, frame.parentJoint, frame_id, placement, shape))
    return geometry


def _hull(points: Array, link: str) -> coal.ConvexBase:
    vertices = coal.StdVec_Vec3s()
    vertices.extend(list(np.unique(points, axis=0)))
    try:
        return coal.Convex.convexHull(vertices, True, "Qt")
    except (ValueError, RuntimeError) as error:
        raise ConfigurationError(
            f"limits.self_collision: the collision elements of link {link!r} have no convex hull: {error}"
        ) from error


def _joined(model: RobotModel, geometry: pin.GeometryModel, first: int, second: int) -> bool:
    """Whether two shapes are on one body, or connected by one or two joints in series."""
    a, b = (geometry.geometryObjects[i].parentJoint for i in (first, second))
    parents = model.pinocchio.parents
    carriers = [(link, parents[link], parents[parents[link]]) for link in (a, b)]
    return bool(b in carriers[0] or a in carriers[1])


def _named(pair: str, links: Sequence[str]) -> tuple[str, str]:
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


def _disabled(srdf: str) -> set[frozenset[str]]:
    """Pairs of links whose collisions an SRDF disables."""
    root = parse_xml(srdf, "limits.self_collision.srdf", "SRDF")
    return {
        frozenset((element.get("link1", ""), element.get("link2", ""))) for element in root.iter("disable_collisions")
    }


def _drop_near(model: RobotModel, geometry: pin.GeometryModel, margin: float) -> tuple[tuple[str, str], ...]:
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
