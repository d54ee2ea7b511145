"""Checks of a robot's configuration before it moves, as reported by `wbc check`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from wbc_controller.assembly.program import make_qp
from wbc_controller.assembly.references import make_board
from wbc_controller.assembly.robot import make_model
from wbc_controller.assembly.robot_description import impossible_inertias
from wbc_controller.core.contacts import LoopClosure, UnilateralContact
from wbc_controller.core.program.infeasibility import explain
from wbc_controller.core.program.layout import FORCE_UNIT
from wbc_controller.core.references.board import ReferenceBoard
from wbc_controller.core.robot.model import RobotModel
from wbc_controller.core.robot.passive import PassiveJoint
from wbc_controller.core.solvers import make_solver
from wbc_controller.core.whole_body_qp import WholeBodyQP
from wbc_controller.errors import ConfigurationError
from wbc_controller.records import Array, References, RobotState, frozen
from wbc_controller.settings import Settings
from wbc_controller.settings.config import Config, load

#: Largest height difference of contacts on one floor, with the base upright, m.
_LEVEL = 0.01
#: Cosine of the largest angle between the floor's normal and that of a contact on the floor, 60°.
_FLOOR = 0.5
#: Largest position error of a loop in the nominal posture, m or rad.
_CLOSED = 1.0e-3
#: Largest torque by which a passive joint may be out of balance, as a share of the smallest effort limit.
_BALANCE = 1.0e-3


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of one check.

    Attributes:
        subject: subject of the check.
        text: result of the check.
    """

    subject: str
    text: str


def stance(
    model: RobotModel, qp: WholeBodyQP, active: Sequence[str], floor_normal: Sequence[float] = (0.0, 0.0, 1.0)
) -> Array:
    """Return the configuration with the nominal posture, base upright and lowest contact on the floor, (nq,).

    Args:
        model: the robot's model.
        qp: the quadratic program of the robot.
        active: names of the active contacts.
        floor_normal: normal of the floor through the world's origin, in the world, (3,).
    """
    q = model.configuration(model.posture)
    qp.dynamics.update(q, np.zeros(model.nv))
    normal = np.array(floor_normal) / np.linalg.norm(floor_normal)
    heights = [points @ normal for points in _on_the_floor(qp, active, normal).values()]
    if model.floating_base and heights:
        q[2] -= np.concatenate(heights).min() / normal[2]
    return q


def _on_the_floor(qp: WholeBodyQP, active: Iterable[str], normal: Array) -> dict[str, Array]:
    """Corners of the active contacts on the floor, in the world; without contacts on a wall, a rail or another link."""
    dynamics, found = qp.dynamics, {}
    for name in active:
        contact = qp.contacts[name]
        if isinstance(contact, UnilateralContact) and not contact.internal:
            push = contact.wrench_in_world(dynamics, np.eye(contact.size)[contact.normal])[:3]
            if push @ normal > _FLOOR:
                found[name] = contact.points(dynamics)
    return found


def check(config: Config | Settings | Mapping[str, Any] | str | Path, urdf: str | None = None) -> list[Finding]:
    """Build all objects of a configuration, and check whether the robot can stand as configured.

    Args:
        config: the configuration, or an argument of `load`.
        urdf: the URDF's text, if ``robot.urdf`` names no file.

    Returns:
        The findings.

    Raises:
        ConfigurationError: if the robot cannot be controlled, or cannot stand still in its nominal posture.
    """
    config = load(config, urdf=urdf)
    settings = config.settings
    try:
        qp = make_qp(settings, make_model(settings, config.urdf))
        return check_qp(settings, qp, make_board(settings, qp))
    except ConfigurationError as error:
        raise ConfigurationError(config.named(str(error))) from error


def check_qp(settings: Settings, qp: WholeBodyQP, board: ReferenceBoard) -> list[Finding]:
    """Check whether a robot, given its quadratic program, can stand as configured; resets the board's references.

    Args:
        settings: the robot's settings.
        qp: the quadratic program of the robot.
        board: the board of references.

    Raises:
        ConfigurationError: as in `check`.
    """
    model = qp.model
    active = [name for name, contact in settings.contacts.items() if contact.enabled]
    normal = np.array(settings.mock.floor_normal) / np.linalg.norm(settings.mock.floor_normal)
    q = stance(model, qp, active, normal)
    findings = [
        Finding("joints", f"{_joints(model)}, base {settings.robot.base}, {len(model.pinocchio.frames)} frames"),
        Finding("mass", f"{model.mass:.2f} kg, weight {model.mass * model.gravity:.1f} N"),
        *_inertias(model),
        Finding("effort limits", f"{model.effort_limits.min():g} to {model.effort_limits.max():g} N·m"),
        Finding("tasks", ", ".join(f"{name} ({task.type})" for name, task in settings.tasks.items())),
        Finding(
            "contacts", ", ".join(f"{name} ({contact.type})" for name, contact in settings.contacts.items()) or "none"
        ),
        Finding("solver", f"{settings.solver.name}, {settings.control.rate:g} cycles per second"),
    ]
    findings += [Finding(limit.kind.replace("_", "-"), limit.summary) for limit in qp.formulation.row_limits]
    qp.dynamics.update(q, np.zeros(model.nv))
    findings += _loops(qp)
    standing = _on_the_floor(qp, active, normal)
    if standing and model.floating_base:
        findings.append(_support(qp, standing, normal))
    board.reset(qp.dynamics, 0.0)
    state = RobotState(0, frozen(q), frozen(np.zeros(model.nv)))
    findings += _balance(qp, _hanging(qp, active))
    findings += _static(qp, state, board.sample(0.0), active, normal)
    return findings


def _inertias(model: RobotModel) -> list[Finding]:
    """Report links with an impossible inertia: if they have a noticeable mass, the model is wrong."""
    names = impossible_inertias(model.urdf)
    return [Finding("inertias", f"no body has that of {', '.join(names)}")] if names else []


def _joints(model: RobotModel) -> str:
    if model.passive is None and model.followers is None and model.actuators == model.joints:
        return f"{model.na} actuated"
    parts = [f"{model.nj}", f"{model.na} actuators"]
    parts += [f"{len(model.passive.joints)} passive"] if model.passive is not None else []
    parts += [f"{len(model.followers)} that follow others"] if model.followers is not None else []
    return ", ".join(parts)


def _loops(qp: WholeBodyQP) -> list[Finding]:
    """Check that the nominal posture closes the loops."""
    loops = [contact for contact in qp.contacts.values() if isinstance(contact, LoopClosure)]
    for loop in loops:
        error = loop.error(qp.dynamics)
        if not (np.abs(error).max() <= _CLOSED):
            parts = [f"{value:.3g} {'rad' if turns else 'm'}" for value, turns in zip(error, loop.moments, strict=True)]
            raise ConfigurationError(
                f"robot.posture: it leaves the loop {loop.name!r} open by [{', '.join(parts)}] along the axes of "
                f"frame_a that it holds (allowed {_CLOSED:g})"
            )
    return [Finding("loops", ", ".join(loop.name for loop in loops) + ": closed in the posture")] if loops else []


def _support(qp: WholeBodyQP, points: Mapping[str, Array], normal: Array) -> Finding:
    heights = {name: float((corners @ normal).max()) for name, corners in points.items()}
    high = [f"{name} {1e3 * height:.0f} mm" for name, height in heights.items() if not (height <= _LEVEL)]
    if high:
        raise ConfigurationError(
            f"robot.posture: with the base upright these contacts are above the floor on which the lowest one stands: "
            f"{', '.join(high)} (allowed {1e3 * _LEVEL:.0f} mm)"
        )
    margin = support_margin(np.vstack(list(points.values()))[:, :2], qp.dynamics.com[:2])
    side = "inside" if margin >= 0.0 else "outside"
    return Finding("centre of mass", f"{1e3 * abs(margin):.0f} mm {side} the edge of the support")


def support_margin(points: Array, position: Array) -> float:
    """Distance from a point to the edge of the convex hull of some points, negative outside.

    Args:
        points: (n, 2) in m.
        position: (2,) in m.
    """
    try:
        hull = ConvexHull(points)
    except QhullError:  # points on a line have no interior
        return -float(np.min(np.linalg.norm(points - position, axis=1)))
    return float(-np.max(hull.equations[:, :2] @ position + hull.equations[:, 2]))


def _static(
    qp: WholeBodyQP, state: RobotState, references: References, active: list[str], normal: Array
) -> list[Finding]:
    """Find torques and forces that hold the robot at rest."""
    model = qp.model
    layout = qp.formulation.build(state, references).snapshot()  # a copy, as it is changed below
    problem = layout.problem
    still = np.delete(np.arange(model.nv), model.v_index[_hanging(qp, active)])
    problem.x_lower[still] = problem.x_upper[still] = 0.0
    problem.b[: layout.mechanism.start] = 0.0  # ignore the small position errors of loops
    solver = make_solver("daqp", problem)
    x = solver.solve(problem).x
    if x is None:
        why = explain(layout, model, qp.formulation.effort_bounds(references), held=("motion",))
        because = f"; {why.sentence}" if why is not None else ""
        raise ConfigurationError(_why_not(qp, tuple(active), normal) + because)
    tau = model.actuation.torques(qp.dynamics.h - FORCE_UNIT * layout.J.T @ x[model.nv :])
    share = np.abs(tau) / model.effort_limits
    worst = int(np.argmax(share))
    names = ", ".join(active) or "no contact"
    return [
        Finding("standing", f"possible on {names}; the largest torque is {abs(tau[worst]):.1f} N·m at "
                            f"{model.actuators[worst]}, {100 * share[worst]:.0f} % of its limit")
    ]  # fmt: skip


def _why_not(qp: WholeBodyQP, active: tuple[str, ...], normal: Array) -> str:
    model = qp.model
    if model.floating_base and not active:
        return "contacts: none is enabled, so a robot with a floating base falls"
    begin = f"the robot cannot stand still in robot.posture on {', '.join(active) or 'its fixed base'}: "
    standing = _on_the_floor(qp, active, normal)
    if set(standing) == set(active) and model.floating_base:
        margin = support_margin(np.vstack(list(standing.values()))[:, :2], qp.dynamics.com[:2])
        if margin < 0.0:
            return begin + f"the centre of mass is {-1e3 * margin:.0f} mm outside the support"
        most = sum(qp.contacts[name].bounds(1.0)[1][2] for name in active)
        weight = model.mass * model.gravity
        if most < weight:
            return begin + (f"contacts: max_normal_force adds up to {most:g} N, and the robot weighs {weight:.1f} N")
    h = qp.dynamics.h  # at rest: gravity minus the springs of passive joints
    over = [
        f"{name} {abs(torque):.1f} of {limit:g} N·m"
        for name, torque, limit in zip(model.actuators, model.actuation.torques(h), model.effort_limits, strict=True)
        if abs(torque) > limit
    ]
    if over and not model.floating_base:
        return begin + "gravity needs more than the effort limit of " + ", ".join(over)
    return begin + (
        "no contact forces within friction and the supports carry the weight within the effort limits "
        f"(scaled by robot.effort_limit_scale, from {model.effort_limits.min():g} to {model.effort_limits.max():g} N·m)"
        + (f" and the springs of {', '.join(model.passive.joints)}" if model.passive is not None else "")
    )


def _hanging(qp: WholeBodyQP, active: list[str]) -> list[int]:
    """Indices of passive joints without support by a contact or loop: only their springs determine where they rest."""
    bearing = [contact for name, contact in qp.contacts.items() if name in active or isinstance(contact, LoopClosure)]
    borne = np.zeros(qp.model.nv, dtype=bool)
    for contact in bearing:
        borne |= np.any(contact.jacobian(qp.dynamics), axis=0)
    driven = qp.model.actuation.driven
    return [i for i, column in enumerate(qp.model.v_index.tolist()) if not driven[i] and not borne[column]]


def _balance(qp: WholeBodyQP, hanging: list[int]) -> list[Finding]:
    """Report unsupported passive joints that are not in balance in the posture, with the `rest` that balances them."""
    model, found = qp.model, []
    torques = model.joint_forces(qp.dynamics.h)  # at rest: gravity minus the springs
    for i in hanging:
        if not abs(torques[i]) <= _BALANCE * float(model.effort_limits.min()):
            spring = model.passive.joints[model.joints[i]] if model.passive is not None else PassiveJoint()
            rest = f" (stays with rest: {spring.rest + torques[i] / spring.stiffness:.6g})" if spring.stiffness else ""
            found.append(f"{model.joints[i]} by {-torques[i]:.2g} N·m{rest}")
    return [Finding("passive joints", "not in balance in the posture: " + ", ".join(found))] if found else []
