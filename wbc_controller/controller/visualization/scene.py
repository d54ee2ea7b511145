"""Shapes of one cycle for markers and plots."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics import tasks as kinds
from wbc_controller.inverse_dynamics.contacts import Contact, UnilateralContact
from wbc_controller.inverse_dynamics.contacts.contact import points_of
from wbc_controller.inverse_dynamics.contacts.support import support_polygon
from wbc_controller.inverse_dynamics.method_calls import array_from
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.records import Array, Reference, References
from wbc_controller.walking.plan import WalkingPlan

FORCE_LENGTH = 0.5  # length of the arrow of the robot's weight, m
CONE_HEIGHT = 0.1  # height of the friction cones, m
_LOADED = 1.0e-3  # smallest normal force of a loaded contact, as a share of the weight
_LOWEST_PENDULUM = 0.1  # smallest height of the centre of mass for a capture point, m

#: Kinds of shapes: arrow between two points, polyline, lines between pairs of points, balls.
ARROW, LINE_STRIP, LINE_LIST, SPHERE_LIST = "arrow", "line_strip", "line_list", "sphere_list"
#: Red, green, blue and opacity of each group, from 0 to 1.
COLORS = {
    "contact_forces": (0.9, 0.2, 0.2, 1.0),
    "friction_cones": (0.9, 0.6, 0.2, 0.6),
    "contacts": (0.6, 0.6, 0.6, 1.0),
    "support": (0.2, 0.7, 0.3, 1.0),
    "com": (0.95, 0.85, 0.2, 1.0),
    "capture_point": (0.2, 0.5, 0.95, 1.0),
    "references": (0.8, 0.3, 0.9, 1.0),
    "task_errors": (0.8, 0.3, 0.9, 1.0),
    "steps": (0.1, 0.6, 0.7, 1.0),
    "swing_paths": (0.1, 0.6, 0.7, 1.0),
}


@dataclass(frozen=True, slots=True)
class Shape:
    """Shape in the world."""

    group: str  # one of `COLORS`
    number: int  # index in the group
    kind: str  # ``arrow``, ``line_strip``, ``line_list`` or ``sphere_list``
    size: float  # diameter of balls and arrow shafts, width of lines, m
    points: Array  # (n, 3) in m, world


def draw(
    dynamics: Dynamics,
    tasks: Mapping[str, kinds.Task],
    contacts: Mapping[str, Contact],
    references: References | None,
    forces: Mapping[str, Array],
    plan: WalkingPlan | None = None,
) -> Iterator[Shape]:
    """Yield the non-empty shapes of one state; `references` and `forces` (`Solution.forces`) may be empty."""
    corners = {name: points_of(contact, dynamics) for name, contact in contacts.items()}
    outer = {name for name, each in contacts.items() if isinstance(each, UnilateralContact) and not each.internal}
    feet = [name for name in (forces or corners) if name in outer]  # not between two links
    standing = np.array([point for name in feet for point in corners[name]]).reshape(-1, 3)
    ground = float(np.mean(standing[:, 2])) if len(standing) else 0.0
    outlines = [edge for points in corners.values() if len(points) > 2 for edge in _edges(points)]
    yield from _shape("contacts", 0, LINE_LIST, 0.004, outlines)
    cones: list[Array] = []
    for i, name in enumerate(contacts):
        if name in forces:
            arrow, pyramid = _contact(dynamics, contacts[name], forces[name], corners[name])
            yield from _shape("contact_forces", i, ARROW, 0.012, arrow)
            cones += pyramid
    yield from _shape("friction_cones", 0, LINE_LIST, 0.003, cones)
    if forces and feet:
        around = support_polygon(standing[:, :2])
        hull = [np.append(point, ground) for point in (*around, *around[:1])]
        yield from _shape("support", 0, LINE_STRIP, 0.008, hull)
    yield from _balance(dynamics, ground)
    if references is not None:
        lines: list[Array] = []
        for name, task in tasks.items():
            if name in references.tasks and references.weights.get(name, 0.0) > 0.0:
                lines += _point_and_reference(task, dynamics, references.tasks[name], ground)
        yield from _shape("task_errors", 0, LINE_LIST, 0.006, lines)
        yield from _shape("references", 0, SPHERE_LIST, 0.02, lines[1::2])
    if plan is not None:
        yield from _steps(dynamics, contacts, plan)


def _steps(dynamics: Dynamics, contacts: Mapping[str, Contact], plan: WalkingPlan) -> Iterator[Shape]:
    """Yield planned touchdowns (outlines or balls), the paths there, and the wanted DCM."""
    ground = 0.0
    for i, (name, landing) in enumerate(plan.landings.items()):
        corners, ground = points_of(contacts[name], dynamics), float(landing[2])
        moved = corners - corners.mean(axis=0) + landing
        moved[:, 2] = ground
        if len(corners) > 2:
            yield from _shape("steps", i, LINE_LIST, 0.008, _edges(moved))
        else:
            yield from _shape("steps", i, SPHERE_LIST, 0.03, moved[:1])
        yield from _shape("swing_paths", i, LINE_STRIP, 0.006, plan.swings[name])
    if plan.landings:
        wanted = plan.wanted_dcm
        yield from _shape("capture_point", 1, SPHERE_LIST, 0.02, [np.array([wanted.real, wanted.imag, ground])])


def friction_used(contacts: Mapping[str, Contact], forces: Mapping[str, Array], weight: float) -> dict[str, float]:
    """Return the tangential force of contacts as a share of the friction limit; NaN if unloaded.

    `forces` is `Solution.forces`, `weight` that of the robot, N.
    """
    used = {}
    for name, force in forces.items():
        contact = contacts[name]
        if isinstance(contact, UnilateralContact):
            tangential = math.hypot(*(float(force[i]) for i in range(3) if i != contact.normal))
            allowed = contact.friction * float(force[contact.normal])
            used[name] = tangential / allowed if force[contact.normal] > _LOADED * weight else math.nan
    return used


def _shape(group: str, number: int, kind: str, size: float, points: Sequence[Array] | Array) -> Iterator[Shape]:
    if len(points):
        yield Shape(group, number, kind, size, np.asarray(points, dtype=np.float64).reshape(-1, 3))


def _contact(dynamics: Dynamics, contact: Contact, force: Array, corners: Array) -> tuple[list[Array], list[Array]]:
    weight, centre = dynamics.model.mass * dynamics.model.gravity, corners.mean(axis=0)
    wrench = array_from(contact, "wrench_in_world", (6,), dynamics, force)
    if not isinstance(contact, UnilateralContact):
        return [centre, centre + FORCE_LENGTH / weight * wrench[:3]], []
    axes = [contact.wrench_in_world(dynamics, unit)[:3] for unit in np.eye(contact.size)[:3]]
    normal = axes[contact.normal]
    origin = centre
    pressure = float(normal @ wrench[:3])
    if pressure > _LOADED * weight:
        torque = wrench[3:] - pin.skew(centre) @ wrench[:3]
        origin = centre + pin.skew(normal) @ torque / pressure
    arrow = [origin, origin + FORCE_LENGTH / weight * wrench[:3]]
    x, y = (CONE_HEIGHT * contact.friction * axes[i] for i in range(3) if i != contact.normal)
    above = centre + CONE_HEIGHT * normal
    # As in `contacts.support.friction_pyramid`, or at the corners of a sole.
    angles = np.arange(8) * math.pi / 4.0 if contact.size == 3 else (np.arange(4) + 0.5) * math.pi / 2.0
    top = [above + math.cos(angle) * x + math.sin(angle) * y for angle in angles.tolist()]
    return arrow, [point for corner in top for point in (centre, corner)] + _edges(top)


def _balance(dynamics: Dynamics, ground: float) -> Iterator[Shape]:
    com = np.array(dynamics.com)
    below = np.array([com[0], com[1], ground])
    yield from _shape("com", 0, SPHERE_LIST, 0.04, [com, below])
    yield from _shape("com", 1, LINE_LIST, 0.004, [com, below])
    if dynamics.model.floating_base:
        omega = math.sqrt(dynamics.model.gravity / max(com[2] - ground, _LOWEST_PENDULUM))
        point = below + np.append(dynamics.com_velocity[:2] / omega, 0.0)
        yield from _shape("capture_point", 0, SPHERE_LIST, 0.03, [point])


def _point_and_reference(task: kinds.Task, dynamics: Dynamics, reference: Reference, ground: float) -> list[Array]:
    wanted = reference.position
    if isinstance(task, kinds.ComTask | kinds.FramePositionTask | kinds.FramePoseTask):
        return [task.position(dynamics)[:3], wanted[:3]]
    if isinstance(task, kinds.CapturePointTask):
        return [np.append(task.position(dynamics), ground), np.append(wanted, ground)]
    if isinstance(task, kinds.RelativePoseTask | kinds.GazeTask):
        model = dynamics.model
        at = dynamics.placement(model.frame_id(task.frame, task.name))
        if isinstance(task, kinds.GazeTask):
            return [at.translation, wanted[:3]]
        return [at.translation, dynamics.placement(model.frame_id(task.reference_frame, task.name)).act(wanted[:3])]
    return []


def _edges(corners: Sequence[Array] | Array) -> list[Array]:
    return [corners[j % len(corners)] for i in range(len(corners)) for j in (i, i + 1)]
