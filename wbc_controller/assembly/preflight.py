"""Checks of a robot's configuration before it moves: what `wbc check` says."""

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

#: Contacts whose heights differ by more, with the base upright, do not stand on one floor, m.
_LEVEL = 0.01
#: Contacts whose normal is turned further from the floor's do not stand on it: cosine of 60°.
_FLOOR = 0.5
#: A loop that is open by more in the nominal posture is a mistake, m or rad.
_CLOSED = 1.0e-3
#: Torque by which a passive joint may be out of balance, as a share of the smallest effort limit.
_BALANCE = 1.0e-3


@dataclass(frozen=True, slots=True)
class Finding:
    """What one check found.

    Attributes:
        subject: what was looked at.
        text: what was found.
    """

    subject: str
    text: str


def stance(
    model: RobotModel, controller: WholeBodyQP, made: Sequence[str], floor_normal: Sequence[float] = (0.0, 0.0, 1.0)
) -> Array:
    """Configuration with the nominal posture, base upright, lowest contact on the floor, (nq,).

    Args:
        model: the robot's model.
        controller: of the robot.
        made: the contacts that are made.
        floor_normal: normal of the floor through the world's origin, in the world, (3,).
    """
    q = model.configuration(model.posture)
    controller.dynamics.update(q, np.zeros(model.nv))
    normal = np.array(floor_normal) / np.linalg.norm(floor_normal)
    heights = [points @ normal for points in _on_the_floor(controller, made, normal).values()]
    if model.floating_base and heights:
        q[2] -= np.concatenate(heights).min() / normal[2]
    return q


def _on_the_floor(controller: WholeBodyQP, made: Iterable[str], normal: Array) -> dict[str, Array]:
    """Corners of the contacts that stand on the floor, in the world: not those with a wall, a rail or another link."""
    dynamics, found = controller.dynamics, {}
    for name in made:
        contact = controller.contacts[name]
        if isinstance(contact, UnilateralContact) and not contact.internal:
            push = contact.wrench_in_world(dynamics, np.eye(contact.size)[contact.normal])[:3]
            if push @ normal > _FLOOR:
                found[name] = contact.points(dynamics)
    return found


def check(config: Config | Settings | Mapping[str, Any] | str | Path, urdf: str | None = None) -> list[Finding]:
    """Build everything that a configuration asks for, and see whether the robot can stand as configured.

    Args:
        config: the configuration, or what `load` takes.
        urdf: the URDF's text, where ``robot.urdf`` names no file.

    Returns:
        What was found.

    Raises:
        ConfigurationError: where the robot cannot be controlled, or cannot stand still in its nominal posture.
    """
    config = load(config, urdf=urdf)
    settings = config.settings
    try:
        qp = make_qp(settings, make_model(settings, config.urdf))
        return check_controller(settings, qp, make_board(settings, qp))
    except ConfigurationError as error:
        raise ConfigurationError(config.named(str(error))) from error


def check_controller(settings: Settings, controller: WholeBodyQP, board: ReferenceBoard) -> list[Finding]:
    """See whether a robot whose quadratic program is built can stand as configured; resets the board's references.

    Args:
        settings: the robot's settings.
        controller: the quadratic program.
        board: the references.

    Raises:
        ConfigurationError: as in `check`.
    """
    model = controller.model
    made = [name for name, contact in settings.contacts.items() if contact.enabled]
    normal = np.array(settings.mock.floor_normal) / np.linalg.norm(settings.mock.floor_normal)
    q = stance(model, controller, made, normal)
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
    findings += [Finding(limit.kind.replace("_", "-"), limit.summary) for limit in controller.formulation.row_limits]
    controller.dynamics.update(q, np.zeros(model.nv))
    findings += _loops(controller)
    standing = _on_the_floor(controller, made, normal)
    if standing and model.floating_base:
        findings.append(_support(controller, standing, normal))
    board.reset(controller.dynamics, 0.0)
    state = RobotState(0, frozen(q), frozen(np.zeros(model.nv)))
    findings += _balance(controller, _hanging(controller, made))
    findings += _static(controller, state, board.sample(0.0), made, normal)
    return findings


def _inertias(model: RobotModel) -> list[Finding]:
    """Say which links have an inertia that no body has: where they weigh something, the model is wrong."""
    names = impossible_inertias(model.urdf)
    return [Finding("inertias", f"no body has that of {', '.join(names)}")] if names else []


def _joints(model: RobotModel) -> str:
    if model.passive is None and model.followers is None and model.actuators == model.joints:
        return f"{model.na} actuated"
    parts = [f"{model.nj}", f"{model.na} actuators"]
    parts += [f"{len(model.passive.joints)} passive"] if model.passive is not None else []
    parts += [f"{len(model.followers)} that follow others"] if model.followers is not None else []
    return ", ".join(parts)


def _loops(controller: WholeBodyQP) -> list[Finding]:
    """See that the nominal posture closes the loops."""
    loops = [contact for contact in controller.contacts.values() if isinstance(contact, LoopClosure)]
    for loop in loops:
        error = loop.error(controller.dynamics)
        if not (np.abs(error).max() <= _CLOSED):
            parts = [f"{value:.3g} {'rad' if turns else 'm'}" for value, turns in zip(error, loop.moments, strict=True)]
            raise ConfigurationError(
                f"robot.posture: it leaves the loop {loop.name!r} open by [{', '.join(parts)}] along the axes of "
                f"frame_a that it holds (allowed {_CLOSED:g})"
            )
    return [Finding("loops", ", ".join(loop.name for loop in loops) + ": closed in the posture")] if loops else []


def _support(controller: WholeBodyQP, points: Mapping[str, Array], normal: Array) -> Finding:
    heights = {name: float((corners @ normal).max()) for name, corners in points.items()}
    high = [f"{name} {1e3 * height:.0f} mm" for name, height in heights.items() if not (height <= _LEVEL)]
    if high:
        raise ConfigurationError(
            f"robot.posture: with the base upright these contacts are above the floor on which the lowest one stands: "
            f"{', '.join(high)} (allowed {1e3 * _LEVEL:.0f} mm)"
        )
    margin = support_margin(np.vstack(list(points.values()))[:, :2], controller.dynamics.com[:2])
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
    except QhullError:  # points on a line: there is no inside
        return -float(np.min(np.linalg.norm(points - position, axis=1)))
    return float(-np.max(hull.equations[:, :2] @ position + hull.equations[:, 2]))


def _static(
    controller: WholeBodyQP, state: RobotState, references: References, made: list[str], normal: Array
) -> list[Finding]:
    """Solve for torques and forces that hold the robot at rest."""
    model = controller.model
    layout = controller.formulation.build(state, references).snapshot()  # later cycles are not to find it changed
    problem = layout.problem
    still = np.delete(np.arange(model.nv), model.v_index[_hanging(controller, made)])
    problem.x_lower[still] = problem.x_upper[still] = 0.0
    problem.b[: layout.mechanism.start] = 0.0  # a loop that is open by a little does not move either
    solver = make_solver("daqp", problem)
    x = solver.solve(problem).x
    if x is None:
        why = explain(layout, model, controller.formulation.effort_bounds(references), held=("motion",))
        because = f"; {why.sentence}" if why is not None else ""
        raise ConfigurationError(_why_not(controller, tuple(made), normal) + because)
    tau = model.actuation.torques(controller.dynamics.h - FORCE_UNIT * layout.J.T @ x[model.nv :])
    share = np.abs(tau) / model.effort_limits
    worst = int(np.argmax(share))
    names = ", ".join(made) or "no contact"
    return [
        Finding("standing", f"possible on {names}; the largest torque is {abs(tau[worst]):.1f} N·m at "
                            f"{model.actuators[worst]}, {100 * share[worst]:.0f} % of its limit")
    ]  # fmt: skip


def _why_not(controller: WholeBodyQP, made: tuple[str, ...], normal: Array) -> str:
    model = controller.model
    if model.floating_base and not made:
        return "contacts: none is enabled, so a robot with a floating base falls"
    begin = f"the robot cannot stand still in robot.posture on {', '.join(made) or 'its fixed base'}: "
    standing = _on_the_floor(controller, made, normal)
    if set(standing) == set(made) and model.floating_base:
        margin = support_margin(np.vstack(list(standing.values()))[:, :2], controller.dynamics.com[:2])
        if margin < 0.0:
            return begin + f"the centre of mass is {-1e3 * margin:.0f} mm outside the support"
        most = sum(controller.contacts[name].bounds(1.0)[1][2] for name in made)
        weight = model.mass * model.gravity
        if most < weight:
            return begin + (f"contacts: max_normal_force adds up to {most:g} N, and the robot weighs {weight:.1f} N")
    h = controller.dynamics.h  # at rest: gravity, less the springs of passive joints
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


def _hanging(controller: WholeBodyQP, made: list[str]) -> list[int]:
    """Passive joints, by number, that no contact or loop bears: their springs alone decide where they rest."""
    bearing = [
        contact for name, contact in controller.contacts.items() if name in made or isinstance(contact, LoopClosure)
    ]
    borne = np.zeros(controller.model.nv, dtype=bool)
    for contact in bearing:
        borne |= np.any(contact.jacobian(controller.dynamics), axis=0)
    driven = controller.model.actuation.driven
    return [i for i, column in enumerate(controller.model.v_index.tolist()) if not driven[i] and not borne[column]]


def _balance(controller: WholeBodyQP, hanging: list[int]) -> list[Finding]:
    """Say which hanging joints will not stay where the posture has them, and what would keep them there."""
    model, found = controller.model, []
    torques = model.joint_forces(controller.dynamics.h)  # at rest: gravity, less the springs
    for i in hanging:
        if not abs(torques[i]) <= _BALANCE * float(model.effort_limits.min()):
            spring = model.passive.joints[model.joints[i]] if model.passive is not None else PassiveJoint()
            rest = f" (stays with rest: {spring.rest + torques[i] / spring.stiffness:.6g})" if spring.stiffness else ""
            found.append(f"{model.joints[i]} by {-torques[i]:.2g} N·m{rest}")
    return [Finding("passive joints", "not in balance in the posture: " + ", ".join(found))] if found else []
