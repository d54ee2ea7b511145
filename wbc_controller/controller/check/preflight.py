"""Pre-flight check, `wbc check`."""

from collections.abc import Iterable, Mapping, Sequence
from math import acos, degrees
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.linalg import null_space
from scipy.spatial import ConvexHull, QhullError

from wbc_controller.controller.build.estimation import estimates_base, make_estimator, make_model_error
from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.references import make_board
from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.build.robot_description import read_urdf
from wbc_controller.controller.check import Finding, contact_shapes, model_plausibility
from wbc_controller.controller.check.gait_check import check_walking
from wbc_controller.controller.check.reserves import bearing_contacts, reserves, static_sways
from wbc_controller.errors import ConfigurationError
from wbc_controller.estimation.projection import split_force
from wbc_controller.inverse_dynamics.contacts import LoopClosure, SurfaceContact, UnilateralContact
from wbc_controller.inverse_dynamics.formulation.infeasibility import explain
from wbc_controller.inverse_dynamics.formulation.problem import FORCE_UNIT
from wbc_controller.inverse_dynamics.formulation.redundancy import LEAST_MOBILITY, mobilities
from wbc_controller.inverse_dynamics.references.board import ReferenceBoard
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.solvers import make_solver
from wbc_controller.inverse_dynamics.tasks import FrameOrientationTask, FramePoseTask
from wbc_controller.inverse_dynamics.tasks.task import AccelerationTask
from wbc_controller.inverse_dynamics.whole_body_qp import WholeBodyQP
from wbc_controller.records import Array, References, RobotState, frozen
from wbc_controller.settings import Settings
from wbc_controller.settings.config import Config, load
from wbc_controller.settings.robot import PassiveJointSettings

#: Largest height difference of floor contacts, m, and as a share of the centre of mass' height.
_LEVEL, _LEVEL_SHARE = 0.01, 0.02
_FLOOR = 0.5  # cosine of the largest angle between floor and contact normal, 60°
_CLOSED = 1.0e-3  # largest position error of a loop in the nominal posture, m or rad
_BALANCE = 1.0e-3  # largest unbalanced torque of a passive joint, as a share of the smallest effort limit
_NEAR = 10.0  # largest distance reported in millimetres, m
_TILTED = 0.0175  # reported tilt of a sole, rad: 1°
_STEEP = 0.0873  # largest tilt of a sole, rad: 5°
_LEAST_SWAY = 1.0e-3  # smallest displacement of the weight that contacts and torques must balance, m
_PART = 0.1  # smallest component of a contact in a redundant direction
_FREE = 1.0e-6  # smallest component of a joint in the null space of tasks and contacts
_RAMPS = (0.2, 0.1, 0.05, 0.02, 0.0)  # suggested values of `safety.activation_ramp`, s


def stance(
    model: RobotModel, qp: WholeBodyQP, active: Sequence[str], floor_normal: Sequence[float] | Array = (0.0, 0.0, 1.0)
) -> Array:
    """Set the dynamics to the nominal posture, upright, lowest contact on the floor through 0; return q, (nq,)."""
    q = model.configuration(model.posture)
    qp.dynamics.update(q, np.zeros(model.nv))
    normal = np.array(floor_normal) / np.linalg.norm(floor_normal)
    heights = [points @ normal for points in floor_contacts(qp, active, normal).values()]
    if model.floating_base and heights:
        q[2] -= np.concatenate(heights).min() / normal[2]
        qp.dynamics.update(q, np.zeros(model.nv))
    return q


def floor_contacts(qp: WholeBodyQP, active: Iterable[str], normal: Array) -> dict[str, Array]:
    """Return the corners of active floor contacts in the world, (n, 3); not on walls, rails or links."""
    dynamics, found = qp.dynamics, {}
    for name in active:
        contact = qp.contacts[name]
        if isinstance(contact, UnilateralContact) and not contact.internal:
            push = contact.wrench_in_world(dynamics, np.eye(contact.size)[contact.normal])[:3]
            if push @ normal > _FLOOR:
                found[name] = contact.points(dynamics)
    return found


def check(config: Config | Settings | Mapping[str, Any] | str | Path, urdf: str | None = None) -> list[Finding]:
    """Build all objects, compare them with URDF and meshes, and check standing; `ConfigurationError` on failure."""
    config = load(config, urdf=urdf)
    settings = config.settings
    try:
        model = make_model(settings, config.urdf)
        model_plausibility.require_inertia(model)
        model_plausibility.require_friction(settings)
        qp = make_qp(settings, model)
        make_model_error(settings, model, qp.contacts)
        if estimates_base(settings, model):
            make_estimator(settings, model, qp.contacts)
        active = [name for name, contact in settings.contacts.items() if contact.enabled]
        normal = _floor(settings)
        q = stance(model, qp, active, normal)
        shapes = contact_shapes.compare_with_shapes(settings, qp, normal)
        findings = [*check_qp(settings, qp, make_board(settings, qp)), *shapes]
        qp.dynamics.update(q, np.zeros(model.nv))
        findings += [*_posture(qp, active, normal), *model_plausibility.locked_joints(model)]
        findings += [*_uncontrolled_joints(settings, qp, active), *_redundant(qp, active)]
        frames = [qp.dynamics.placement(i).translation for i in range(1, len(model.pinocchio.frames))]
        findings += model_plausibility.limits(settings, model, np.array(frames))
        findings += model_plausibility.motors_without_effort(settings, config.urdf or read_urdf(settings.robot.urdf))
        if model.floating_base:
            findings += _activation_ramp(settings, qp)
            qp.dynamics.update(q, np.zeros(model.nv))
            hanging, level = unsupported_passive_joints(qp, active), _is_kept_level(settings, qp)
            findings += reserves(qp, active, q, hanging, level=level, margin=settings.limits.margin)
        findings += check_walking(settings, qp)
        return findings
    except ConfigurationError as error:
        raise ConfigurationError(config.with_source(str(error))) from error


def check_qp(settings: Settings, qp: WholeBodyQP, board: ReferenceBoard) -> list[Finding]:
    """Check that a robot can stand, or raise `ConfigurationError`; resets the board."""
    model = qp.model
    active = [name for name, contact in settings.contacts.items() if contact.enabled]
    normal = _floor(settings)
    q = stance(model, qp, active, normal)
    contacts = ", ".join(f"{name} ({contact.type})" for name, contact in settings.contacts.items())
    findings = [
        Finding("joints", f"{_joints(model)}, base {settings.robot.base}, {len(model.pinocchio.frames)} frames"),
        Finding("mass", f"{model.mass:.2f} kg, weight {model.mass * model.gravity:.1f} N"),
        *model_plausibility.inertias(model),
        Finding("effort limits", f"{model.effort_limits.min():g} to {model.effort_limits.max():g} N·m"),
        Finding("tasks", ", ".join(f"{name} ({task.type})" for name, task in settings.tasks.items())),
        Finding("contacts", contacts or "none"),
        Finding("solver", f"{settings.solver.name}, {settings.control.rate:g} cycles per second"),
    ]
    findings += [Finding(limit.kind.replace("_", "-"), limit.summary) for limit in qp.formulation.row_limits]
    findings += _loops(qp)
    standing = floor_contacts(qp, active, normal)
    if standing and model.floating_base:
        findings.append(_support(qp, standing, normal))
    board.reset(qp.dynamics, 0.0)
    state = RobotState(0, frozen(q), frozen(np.zeros(model.nv)))
    findings += _balance(qp, unsupported_passive_joints(qp, active))
    findings += _static(qp, state, board.sample(0.0), active, normal)
    return findings


def _floor(settings: Settings) -> Array:
    return np.asarray(np.array(settings.mock.floor_normal) / np.linalg.norm(settings.mock.floor_normal))


def _posture(qp: WholeBodyQP, active: Sequence[str], normal: Array) -> list[Finding]:
    dynamics, link = qp.dynamics, qp.model.base_link
    base = dynamics.placement(qp.model.frame_id(link, "base")).translation
    base_at, com_at = map(contact_shapes.point_text, (base, dynamics.com))
    places = f"base link {link} at {base_at} m, centre of mass at {com_at} m"
    findings = [Finding("posture", f"in the world: {places}")]
    tilts = {
        name: acos(float(np.clip(contact.placement(dynamics).rotation[:, 2] @ normal, -1.0, 1.0)))
        for name in floor_contacts(qp, active, normal)
        if isinstance(contact := qp.contacts[name], SurfaceContact)
    }
    steep = [f"{name} {degrees(tilt):.0f}°" for name, tilt in tilts.items() if not (tilt <= _STEEP)]
    if steep:
        tilted = f"{', '.join(steep)} (allowed {degrees(_STEEP):.0f}°)"
        raise ConfigurationError(f"robot.posture: tilt of soles against the floor with upright base: {tilted}")
    if tilts:
        text = ", ".join(f"{name} {degrees(tilt):.1f}°" for name, tilt in tilts.items())
        turns = max(tilts.values()) > _TILTED
        why = "; the robot will tilt on release until they lie flat: correct robot.posture" if turns else ""
        findings.append(Finding("tilt of soles", f"against the floor: {text}{why}"))
    return findings


def _uncontrolled_joints(settings: Settings, qp: WholeBodyQP, active: Sequence[str]) -> list[Finding]:
    model, dynamics = qp.model, qp.dynamics
    tasks = [
        task.jacobian(dynamics)[task.rows]
        for name, task in qp.tasks.items()
        if isinstance(task, AccelerationTask) and settings.tasks.get(name, task).enabled
    ]
    held = [contact.jacobian(dynamics) for contact in bearing_contacts(qp, active)]
    rows = np.vstack([np.zeros((1, model.nv)), *tasks, *held, model.actuation.C])
    free = np.abs(null_space(rows)[model.v_index]).max(axis=1, initial=0.0) > _FREE
    names = [name for name, loose in zip(model.joints, free, strict=True) if loose]
    return [Finding("uncontrolled", f"{', '.join(names)}: add them to a task of type posture")] if names else []


def _is_kept_level(settings: Settings, qp: WholeBodyQP) -> bool:
    frames, model = qp.model.pinocchio.frames, qp.model
    base = frames[model.frame_id(model.base_link, "base")].parentJoint
    return any(
        isinstance(task, (FrameOrientationTask, FramePoseTask))
        and frames[model.frame_id(task.frame, name)].parentJoint == base
        for name, task in qp.tasks.items()
        if settings.tasks.get(name, task).enabled
    )


def _redundant(qp: WholeBodyQP, active: Sequence[str]) -> list[Finding]:
    contacts = bearing_contacts(qp, active)
    if not contacts:
        return []
    J = np.vstack([contact.jacobian(qp.dynamics) for contact in contacts])
    values, directions = mobilities(J, np.concatenate([contact.metric for contact in contacts]), qp.dynamics)
    part = np.abs(directions[:, values < LEAST_MOBILITY]).max(axis=1, initial=0.0)
    parts = np.split(part, np.cumsum([contact.size for contact in contacts])[:-1])
    names = [contact.name for contact, own in zip(contacts, parts, strict=True) if own.max() > _PART]
    if not names:
        return []
    text = (
        f"{np.count_nonzero(values < LEAST_MOBILITY)} of {len(J)} constrained directions, at {', '.join(names)}: no "
        "joint moves the contacts along them; motions that require it are limited (sway) or cause slip"
    )
    return [Finding("redundant contacts", text)]


def _joints(model: RobotModel) -> str:
    if model.passive is None and model.followers is None and model.actuators == model.joints:
        return f"{model.na} actuated"
    parts = [f"{model.nj}", f"{model.na} actuators"]
    parts += [f"{len(model.passive.joints)} passive"] if model.passive is not None else []
    parts += [f"{len(model.followers)} mimic joints"] if model.followers is not None else []
    return ", ".join(parts)


def _loops(qp: WholeBodyQP) -> list[Finding]:
    loops = [contact for contact in qp.contacts.values() if isinstance(contact, LoopClosure)]
    for loop in loops:
        error = loop.error(qp.dynamics)
        if not (np.abs(error).max() <= _CLOSED):
            parts = [f"{value:.3g} {'rad' if turns else 'm'}" for value, turns in zip(error, loop.moments, strict=True)]
            text = f"[{', '.join(parts)}] along its constrained axes of frame_a (allowed {_CLOSED:g})"
            raise ConfigurationError(f"robot.posture: position error of the loop {loop.name!r}: {text}")
    return [Finding("loops", ", ".join(loop.name for loop in loops) + ": closed in the posture")] if loops else []


def _support(qp: WholeBodyQP, points: Mapping[str, Array], normal: Array) -> Finding:
    heights = {name: float((corners @ normal).max()) for name, corners in points.items()}
    level = min(_LEVEL, _LEVEL_SHARE * float(qp.dynamics.com @ normal))
    high = [f"{name} {1e3 * height:.0f} mm" for name, height in heights.items() if not (height <= level)]
    if high:
        problem = "with the base upright these contacts reach above the floor on which the lowest one stands"
        raise ConfigurationError(f"robot.posture: {problem}: {', '.join(high)} (allowed {1e3 * level:.0f} mm)")
    margin = support_margin(np.vstack(list(points.values()))[:, :2], qp.dynamics.com[:2])
    side = "inside" if margin >= 0.0 else "outside"
    return Finding("centre of mass", f"{_length(margin)} {side} the edge of the support")


def _length(distance: float) -> str:
    size = abs(distance)
    return f"{1e3 * size:.0f} mm" if size < _NEAR else f"{size:.3g} m"


def support_margin(points: Array, position: Array) -> float:
    """Return the distance of a position, (2,), inside the edge of the hull of points, (n, 2), m; negative outside."""
    try:
        hull = ConvexHull(points)
    except QhullError:  # collinear points
        start = points[np.argmax(np.linalg.norm(points - points[0], axis=1))]
        line = points[np.argmax(np.linalg.norm(points - start, axis=1))] - start
        share = np.clip((position - start) @ line / max(float(line @ line), 1.0e-300), 0.0, 1.0)
        return -float(np.linalg.norm(position - start - share * line))
    return float(-np.max(hull.equations[:, :2] @ position + hull.equations[:, 2]))


def _static(
    qp: WholeBodyQP, state: RobotState, references: References, active: list[str], normal: Array
) -> list[Finding]:
    model, hanging = qp.model, unsupported_passive_joints(qp, active)
    layout = qp.formulation.build(state, references).snapshot()
    problem = layout.problem
    still = np.delete(np.arange(model.nv), model.v_index[hanging])
    problem.x_lower[still] = problem.x_upper[still] = 0.0
    problem.b[: layout.mechanism.start] = 0.0  # ignores small position errors of loops
    x = make_solver("daqp", problem).solve(problem).x
    if x is None:
        why = explain(layout, model, qp.formulation.effort_bounds(references), held=("motion",))
        because = f"; {why.sentence}" if why is not None else ""
        problems = [contact_shapes.upside_down(qp, name, normal) for name in active]
        if any(problems):
            raise ConfigurationError(next(filter(None, problems)))
        raise ConfigurationError(_standing_failure(qp, tuple(active), normal) + because)
    if model.floating_base:
        sways = static_sways(qp, active, hanging)
        least = min(sways, key=lambda name: sways[name].most)
        if not (sways[least].most >= _LEAST_SWAY):
            raise ConfigurationError(
                f"{_standing_failure(qp, tuple(active), normal)}; a sway of {1e3 * _LEAST_SWAY:g} mm must be possible, "
                f"not only {1e3 * abs(sways[least].most):.1f} mm {least}: add a contact or a surface, or correct "
                "robot.posture"
            )
    tau = model.actuation.torques(qp.dynamics.h - FORCE_UNIT * layout.J.T @ x[model.nv :])
    share = np.abs(tau) / model.effort_limits
    worst = int(np.argmax(share))
    largest = f"{abs(tau[worst]):.1f} N·m at {model.actuators[worst]}, {100 * share[worst]:.0f} % of its limit"
    return [Finding("standing", f"possible on {', '.join(active) or 'no contact'}; the largest torque is {largest}")]


def _standing_failure(qp: WholeBodyQP, active: tuple[str, ...], normal: Array) -> str:
    model = qp.model
    if model.floating_base and not active:
        return "contacts: none is enabled; a robot with a floating base falls"
    begin = f"the robot cannot stand still in robot.posture on {', '.join(active) or 'its fixed base'}: "
    standing = floor_contacts(qp, active, normal)
    if set(standing) == set(active) and model.floating_base:
        margin = support_margin(np.vstack(list(standing.values()))[:, :2], qp.dynamics.com[:2])
        if abs(margin) < _LEAST_SWAY:
            return begin + "the centre of mass is above the edge of the support"
        if margin < 0.0:
            far = "; correct the origins of the <inertial> elements in the URDF" if -margin > _NEAR else ""
            return begin + f"the centre of mass is {_length(margin)} outside the support{far}"
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


def _activation_ramp(settings: Settings, qp: WholeBodyQP) -> list[Finding]:
    ramp = settings.safety.activation_ramp
    longest, fastest = longest_ramp(settings, qp)
    if longest == ramp:
        return []
    text = (
        f"safety.activation_ramp = {ramp:g} s: unsupported joints fall meanwhile ({fastest} fastest), and the torques "
        f"cannot stop them within their limits; use at most {longest:g} s, or let them hang at activation"
    )
    return [Finding("warning", text)]


def longest_ramp(settings: Settings, qp: WholeBodyQP) -> tuple[float, str]:
    """Return the longest usable `safety.activation_ramp` up to the configured one, s, and the fastest falling joint.

    The torques must meet all joint limits after a ramp of T s on a hoist, without moving the base. If they cannot at
    rest either, the configured ramp is returned. Torques that grow from zero to gravity's permit v = a T / 2 and a
    motion of a T² / 3 by the acceleration a of free fall.
    """
    model, dynamics, ramp = qp.model, qp.dynamics, settings.safety.activation_ramp
    active = [name for name, contact in settings.contacts.items() if contact.enabled]
    start = stance(model, qp, active)
    board = make_board(settings, qp)
    board.reset(dynamics, 0.0)
    references = board.sample(0.0)
    held = [qp.contacts[name].jacobian(dynamics) for name in active]
    J = np.vstack([np.eye(6, model.nv), model.actuation.C, *held])
    fall = np.linalg.solve(dynamics.M, split_force(dynamics.M, J, -dynamics.h)[0])
    fall[:6] = 0.0  # exactly

    def stops_after(ramp: float) -> bool:
        q = np.asarray(pin.integrate(model.pinocchio, start, ramp**2 / 3.0 * fall))
        state = RobotState(0, frozen(q), frozen(0.5 * ramp * fall))
        problem = qp.formulation.build(state, references).snapshot().problem
        problem.x_lower[:6] = problem.x_upper[:6] = 0.0
        return make_solver("daqp", problem).solve(problem).x is not None

    ramps = (ramp, *(each for each in _RAMPS if each < ramp))
    fastest = model.joints[int(np.argmax(np.abs(fall[model.v_index])))]
    return next((each for each in ramps if stops_after(each)), ramp), fastest


def unsupported_passive_joints(qp: WholeBodyQP, active: Sequence[str]) -> list[int]:
    """Return the indices of passive joints without a contact or loop: only springs hold them."""
    borne = np.zeros(qp.model.nv, dtype=bool)
    for contact in bearing_contacts(qp, active):
        borne |= np.any(contact.jacobian(qp.dynamics), axis=0)
    driven = qp.model.actuation.driven
    return [i for i, column in enumerate(qp.model.v_index.tolist()) if not driven[i] and not borne[column]]


def _balance(qp: WholeBodyQP, hanging: list[int]) -> list[Finding]:
    model, found = qp.model, []
    torques = model.joint_forces(qp.dynamics.h)  # at rest: gravity minus the springs
    for i in hanging:
        if not abs(torques[i]) <= _BALANCE * float(model.effort_limits.min()):
            spring = model.passive.joints[model.joints[i]] if model.passive is not None else PassiveJointSettings()
            rest = f" (balanced by rest: {spring.rest + torques[i] / spring.stiffness:.6g})" if spring.stiffness else ""
            found.append(f"{model.joints[i]} by {-torques[i]:.2g} N·m{rest}")
    return [Finding("passive joints", "out of balance in robot.posture: " + ", ".join(found))] if found else []
