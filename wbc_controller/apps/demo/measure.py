"""Makes a recording from the messages of a run, and the verdict from the recording."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from wbc_controller.apps.demo.director import Director, Log, Window
from wbc_controller.apps.demo.scenario import Scenario
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware.codec import decode
from wbc_controller.middleware.joint_states import JointStateReader
from wbc_controller.middleware.stamps import header_time
from wbc_controller.middleware.states import OdometryReader
from wbc_controller.recording.columns import AUDIT_COLUMNS
from wbc_controller.recording.report.run_record import Recording, Result, supports_of, vertical_on_base
from wbc_controller.records import Array
from wbc_controller.settings import FixedContact, PointContact, RollingContact, Settings


def make_recording(
    name: str, settings: Settings, model: RobotModel, director: Director, cycles: Mapping[str, Array]
) -> Recording:
    """Decode the messages of a run.

    Args:
        name: name of the robot.
        settings: settings of the robot.
        model: model of the robot.
        director: the director that played the scenario.
        cycles: the controller's own record, as `recording.columns` gives it.
    """
    log = director.log
    time, q = _states(log, model)
    data = model.pinocchio.createData()
    com = np.array([pin.centerOfMass(model.pinocchio, data, sample) for sample in q])
    reference = np.full_like(com, np.nan)
    for start, trajectory in director.references:
        for i in np.flatnonzero(time >= start):
            reference[i] = trajectory.sample(float(time[i])).position
    errors = {}
    for task, target in director.targets.items():
        window = director.windows.get(f"reach {task}")
        frame = settings.tasks[task].frame  # type: ignore[union-attr]  # every reach uses a frame task
        distance = _frame_distance(model, frame, q, target)
        inside = (time >= window.start) & (time <= window.end) if window else np.zeros(len(time), dtype=bool)
        errors[task] = np.where(inside, distance, np.nan)
    return Recording(
        robot=name,
        actuators=model.actuators,
        time=time - time[0],
        q=q,
        tau=_aligned(
            log,
            ("controller", "joint_commands", ""),
            time,
            lambda content: model.actuation.from_joints(content.effort),
            model.na,
        ),
        effort_limits=model.effort_limits,
        com=com,
        com_reference=reference,
        frame_errors=errors,
        contact_wrenches=_wrenches(log, "controller", settings, time),
        unmodelled=_unmodelled(cycles, model, time),
        true_wrenches=_wrenches(log, "mock", settings, time),
        friction={
            contact: spec.friction for contact, spec in settings.contacts.items() if not isinstance(spec, FixedContact)
        },
        cycle_seconds=cycles["seconds/total"],
        stage_seconds={
            stage.removeprefix("seconds/"): seconds
            for stage, seconds in cycles.items()
            if stage in ("seconds/read", "seconds/compute", "seconds/supervise", "seconds/write")
        },
        events=tuple(replace(event, time=max(0.0, event.time - time[0])) for event in director.events),
        results=(),
        modes=_modes(cycles, time[0]),
        supports=supports_of(settings.contacts),
        audit=_audit(cycles, time),
    )


def _states(log: Log, model: RobotModel) -> tuple[Array, Array]:
    """Times (n,) and configurations (n, nq) from joint states and the base states of the same stamps."""
    joints, bases = JointStateReader(model.joints, "position"), OdometryReader(model.base_link)
    odometry = {header_time(payload): payload for payload in log.messages.get(("mock", "odom", ""), ())}
    times, configurations = [], []
    last = -np.inf
    for payload in log.messages["mock", "joint_states", ""]:
        time = header_time(payload)
        if time <= last or (model.floating_base and time not in odometry):
            continue
        position = joints.read(payload).position
        base: tuple[Array, ...] = ()
        if model.floating_base:
            base = bases.read(odometry[time])[1:]
        q, _ = model.state(position, np.zeros(model.nj), *base)
        times.append(time)
        configurations.append(q)
        last = time
    return np.array(times), np.array(configurations)


def _aligned(log: Log, key: tuple[str, str, str], time: Array, read: Callable[[Any], Any], size: int) -> Array:
    """Values of a stamped topic at given times: the last value up to that time; NaN before the first."""
    payloads = log.messages[key]
    stamps = np.array([header_time(payload) for payload in payloads])
    values = np.array([read(decode(payload, log.types[key])) for payload in payloads])
    if not len(stamps):
        return np.full((len(time), size), np.nan)
    order = np.argsort(stamps, kind="stable")
    index = np.searchsorted(stamps[order], time + 1.0e-9, side="right") - 1
    aligned = values[order][np.maximum(index, 0)]
    aligned[index < 0] = np.nan
    return np.asarray(aligned)


def _modes(cycles: Mapping[str, Array], start: float) -> tuple[tuple[float, str], ...]:
    """The controller's modes, each with the time at which it began, s since the start."""
    modes = [str(mode) for mode in cycles["mode"]]
    times = [max(0.0, 1.0e-9 * float(stamp) - start) for stamp in cycles["stamp"]]
    changes = [i for i, mode in enumerate(modes) if i == 0 or mode != modes[i - 1]]
    return tuple((times[i], modes[i]) for i in changes)


def _audit(cycles: Mapping[str, Array], time: Array) -> dict[str, Array]:
    """Values of the last audit up to each of the given times."""
    return dict(zip(AUDIT_COLUMNS, _last(cycles["audit"], cycles, time).T, strict=True))


def _unmodelled(cycles: Mapping[str, Array], model: RobotModel, time: Array) -> Array:
    """Vertical force on the base that the last solution up to each time takes into account beside the model, N."""
    rows = zip(cycles["q"], cycles["disturbance"], strict=True)
    return _last(np.array([vertical_on_base(model, q, forces) for q, forces in rows]), cycles, time)


def _last(values: Array, cycles: Mapping[str, Array], time: Array) -> Array:
    """The values of the last cycle up to each of the given times; NaN before the first."""
    index = np.searchsorted(1.0e-9 * cycles["stamp"], time + 1.0e-9, side="right") - 1
    found = np.array(values)[np.maximum(index, 0)]
    found[index < 0] = np.nan
    return found


def _wrenches(log: Log, owner: str, settings: Settings, time: Array) -> dict[str, Array]:
    def six(content: Any) -> list[float]:
        force, torque = content.wrench.force, content.wrench.torque
        return [force.x, force.y, force.z, torque.x, torque.y, torque.z]

    return {
        name: _aligned(log, (owner, "contact_wrench", name), time, six, 6)[
            :, : 3 if isinstance(contact, PointContact | RollingContact) else 6
        ]
        for name, contact in settings.contacts.items()
    }


def _frame_distance(model: RobotModel, frame: str, q: Array, target: Array) -> Array:
    data, frame_id = model.pinocchio.createData(), model.frame_id(frame, "frame")
    distances = []
    for sample in q:
        pin.framesForwardKinematics(model.pinocchio, data, sample)
        distances.append(np.linalg.norm(data.oMf[frame_id].translation - target))
    return np.array(distances)


def judge(
    recording: Recording,
    scenario: Scenario,
    windows: Mapping[str, Window],
    start: float,
    weight: float,
) -> tuple[Result, ...]:
    """Compare a run with its targets.

    Args:
        recording: recording of the run.
        scenario: the scenario with the targets.
        windows: time windows of the measurements, on the clock of the states.
        start: time of the recording's zero on that clock, s.
        weight: weight of the robot, N.
    """
    error = np.linalg.norm(recording.com - recording.com_reference, axis=1)

    def within(name: str, values: Array, after: float = 0.0) -> Array:
        """The values in a window; none if the run did not reach it."""
        window = windows.get(name)
        if window is None:
            return values[:0]
        time = recording.time + start
        return values[(time >= window.start + after) & (time <= window.end)]

    results = []
    # Where motors are not exact, the program takes some of the weight for an unmodelled force on the base.
    for label, wrenches, beside in (
        ("QP", recording.contact_wrenches, recording.unmodelled),
        ("MuJoCo", recording.true_wrenches, np.zeros(len(recording.time))),
    ):
        if not wrenches:  # nothing but the base carries the weight
            continue
        force = beside + np.sum([values[:, 2] for values in wrenches.values()], axis=0)
        deviation = np.abs(within("stand", force) / weight - 1.0)
        results.append(_share(f"stand: vertical force, {label}", deviation, scenario.force_target))
    for move in scenario.moves:
        squares = within(move.name, error) ** 2
        rms = np.sqrt(np.mean(squares, keepdims=True)) if len(squares) else squares
        results.append(_distance(f"{move.name}: RMS error", rms, move.target_rms))
    for reach in scenario.reaches:
        distance = within(f"reach {reach.task}", recording.frame_errors.get(reach.task, error))
        results.append(_distance(f"reach: {reach.task} error", distance[-1:], reach.target))
    for shove in scenario.shoves:
        name = f"{shove.name} {np.linalg.norm(shove.impulse):g} N·s"
        peak = within(shove.name, error)
        result = _distance(name, within(shove.name, error, scenario.recovery), scenario.recovery_target)
        if len(peak):
            result = replace(result, measured=f"{result.measured} (peak {1e3 * np.max(peak):.0f})")
        results.append(replace(result, target=f"{result.target} in {scenario.recovery:g} s"))
    if recording.audit:
        calm = [
            "stand",
            *(move.name for move in scenario.moves),
            *(f"reach {reach.task}" for reach in scenario.reaches),
        ]
        results.append(_audited(np.concatenate([within(name, recording.audit["warnings"]) for name in calm])))
    share = np.abs(recording.tau) / recording.effort_limits
    sent = share[~np.isnan(share).all(axis=1)]  # without the samples before the first command
    results.append(_torques(sent))
    return tuple(results)


def _distance(name: str, values: Array, limit: float) -> Result:
    """Compare the largest of some distances in m with a limit; NaN, or no values at all, miss the target."""
    measured = f"{1e3 * np.max(values):.2f} mm" if len(values) else "not reached"
    return Result(name, f"below {1e3 * limit:g} mm", measured, len(values) > 0 and bool(np.max(values) < limit))


def _share(name: str, values: Array, limit: float) -> Result:
    """Compare the largest of some deviations from the weight, as shares of it, with a limit."""
    measured = f"{100.0 * np.max(values):.3f} % off" if len(values) else "not reached"
    good = len(values) > 0 and bool(np.max(values) <= limit)
    return Result(name, f"weight ± {100.0 * limit:g} %", measured, good)


def _audited(warnings: Array) -> Result:
    """Check that the audit does not warn while the robot is undisturbed."""
    measured = f"{int(np.count_nonzero(warnings))} of {len(warnings)} samples" if len(warnings) else "not reached"
    good = len(warnings) > 0 and not np.any(warnings != 0)
    return Result("model audit: false warnings", "none", measured, good)


def _torques(share: Array) -> Result:
    measured = f"{100.0 * np.max(share):.1f} %" if len(share) else "none was sent"
    good = len(share) > 0 and bool(np.max(share) <= 1.0)
    return Result("largest torque / limit", "at most 100 %", measured, good)


def passed(results: Sequence[Result]) -> bool:
    """Whether all targets were met."""
    return bool(results) and all(result.passed for result in results)
