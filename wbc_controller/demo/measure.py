"""From the messages of a run to a recording, and from that to the verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from wbc_controller.core.model import RobotModel
from wbc_controller.decoding import JointOrder, read_odometry
from wbc_controller.demo.director import Director, Log, Window, header_time
from wbc_controller.demo.recording import Recording, Result, supports_of
from wbc_controller.demo.scenario import Scenario
from wbc_controller.messages import decode
from wbc_controller.records import Array
from wbc_controller.settings import Settings, SurfaceContact


def make_recording(
    name: str, settings: Settings, model: RobotModel, director: Director, cycles: Mapping[str, Array]
) -> Recording:
    """Decode what was seen.

    Args:
        name: of the robot.
        settings: its settings.
        model: its model.
        director: that played the scenario.
        cycles: what the controller recorded: ``seconds/<stage>`` for each cycle.
    """
    log = director.log
    time, q = _states(log, model)
    com = np.array([pin.centerOfMass(model.pinocchio, _DATA.of(model), sample) for sample in q])
    reference = np.full_like(com, np.nan)
    for start, trajectory in director.references:
        for i in np.flatnonzero(time >= start):
            reference[i] = trajectory.sample(float(time[i])).position
    errors = {}
    for task, target in director.targets.items():
        window = director.windows.get(f"reach {task}")
        frame = settings.tasks[task].frame  # type: ignore[union-attr]  # only frame tasks are reached with
        distance = _frame_distance(model, frame, q, target)
        inside = (time >= window.start) & (time <= window.end) if window else np.zeros(len(time), dtype=bool)
        errors[task] = np.where(inside, distance, np.nan)
    return Recording(
        robot=name,
        joints=model.joints,
        time=time - time[0],
        q=q,
        tau=_aligned(log, ("controller", "joint_commands", ""), time, lambda content: content.effort, model.na),
        effort_limits=model.effort_limits,
        com=com,
        com_reference=reference,
        frame_errors=errors,
        contact_wrenches=_wrenches(log, "controller", settings, time),
        true_wrenches=_wrenches(log, "mock", settings, time),
        friction={contact: spec.friction for contact, spec in settings.contacts.items()},
        cycle_seconds=cycles["seconds/total"],
        stage_seconds={
            stage.removeprefix("seconds/"): seconds
            for stage, seconds in cycles.items()
            if stage in ("seconds/read", "seconds/compute", "seconds/supervise", "seconds/write")
        },
        events=tuple(replace(event, time=max(0.0, event.time - time[0])) for event in director.events),
        results=(),
        supports=supports_of(settings.contacts),
    )


class _DataOf:
    """One Pinocchio workspace per model."""

    def __init__(self) -> None:
        self._data: dict[int, object] = {}

    def of(self, model: RobotModel) -> object:
        return self._data.setdefault(id(model.pinocchio), model.pinocchio.createData())


_DATA = _DataOf()


def _states(log: Log, model: RobotModel) -> tuple[Array, Array]:
    """Times (n,) and configurations (n, nq): joint states with the base state of the same stamp."""
    order = JointOrder(model.joints)
    odometry = {header_time(payload): payload for payload in log.messages.get(("mock", "odom", ""), ())}
    times, configurations = [], []
    last = -np.inf
    for payload in log.messages["mock", "joint_states", ""]:
        time = header_time(payload)
        if time <= last or (model.floating_base and time not in odometry):
            continue
        q = np.zeros(model.nq)
        q[model.q_index] = order.read(decode(payload, "sensor_msgs/msg/JointState"))[0]
        if model.floating_base:
            q[:7] = read_odometry(decode(odometry[time], "nav_msgs/msg/Odometry"), model.base_link)[0]
        times.append(time)
        configurations.append(q)
        last = time
    return np.array(times), np.array(configurations)


def _aligned(log: Log, key: tuple[str, str, str], time: Array, read: object, size: int) -> Array:
    """Values of a stamped topic at given times: the newest that is not later; NaN before the first."""
    payloads = log.messages[key]
    stamps = np.array([header_time(payload) for payload in payloads])
    values = np.array([read(decode(payload, log.types[key])) for payload in payloads])  # type: ignore[operator]
    if not len(stamps):
        return np.full((len(time), size), np.nan)
    order = np.argsort(stamps, kind="stable")
    index = np.searchsorted(stamps[order], time + 1.0e-9, side="right") - 1
    aligned = values[order][np.maximum(index, 0)]
    aligned[index < 0] = np.nan
    return np.asarray(aligned)


def _wrenches(log: Log, owner: str, settings: Settings, time: Array) -> dict[str, Array]:
    def six(content: object) -> list[float]:
        force, torque = content.wrench.force, content.wrench.torque  # type: ignore[attr-defined]
        return [force.x, force.y, force.z, torque.x, torque.y, torque.z]

    return {
        name: _aligned(log, (owner, "contact_wrench", name), time, six, 6)[
            :, : 6 if isinstance(contact, SurfaceContact) else 3
        ]
        for name, contact in settings.contacts.items()
    }


def _frame_distance(model: RobotModel, frame: str, q: Array, target: Array) -> Array:
    data, frame_id = _DATA.of(model), model.pinocchio.getFrameId(frame)
    distances = []
    for sample in q:
        pin.framesForwardKinematics(model.pinocchio, data, sample)
        distances.append(np.linalg.norm(data.oMf[frame_id].translation - target))  # type: ignore[attr-defined]
    return np.array(distances)


def judge(
    recording: Recording,
    scenario: Scenario,
    windows: Mapping[str, Window],
    start: float,
    weight: float,
) -> tuple[Result, ...]:
    """Hold a run against its targets.

    Args:
        recording: of the run.
        scenario: with the targets.
        windows: what is measured when, on the clock of the states.
        start: time of the recording's zero on that clock, s.
        weight: of the robot, N.
    """
    results: list[Result] = []

    def inside(name: str, after: float = 0.0) -> np.ndarray | None:
        window = windows.get(name)
        if window is None:
            return None
        time = recording.time + start
        return np.asarray((time >= window.start + after) & (time <= window.end))

    def add(name: str, target: str, unit: float, suffix: str, value: float | None, limit: float) -> None:
        measured = "not reached" if value is None else f"{unit * value:.2f} {suffix}"
        results.append(Result(name, target, measured, value is not None and bool(value <= limit)))

    error = np.linalg.norm(recording.com - recording.com_reference, axis=1)
    where = inside("stand")
    for label, wrenches in (("QP", recording.contact_wrenches), ("simulator", recording.true_wrenches)):
        value = None
        if where is not None:
            total = sum(values[where, 2] for values in wrenches.values())
            value = float(np.max(np.abs(total / weight - 1.0)))
        limit = scenario.force_target
        add(f"standing: vertical forces against the weight, {label}", f"within {100 * limit:g} %", 100.0, "%", value,
            limit)  # fmt: skip
    for move in scenario.moves:
        where = inside(move.name)
        value = None if where is None else float(np.sqrt(np.mean(error[where] ** 2)))
        add(f"{move.name}: centre of mass, RMS error", f"below {1e3 * move.target_rms:g} mm", 1e3, "mm", value,
            move.target_rms)  # fmt: skip
    for reach in scenario.reaches:
        where = inside(f"reach {reach.task}")
        value = None if where is None else float(recording.frame_errors[reach.task][where][-1])
        add(f"reach: {reach.task}, final error", f"below {1e3 * reach.target:g} mm", 1e3, "mm", value, reach.target)
    for shove in scenario.shoves:
        where = inside(shove.name, scenario.recovery)
        value = None if where is None else float(np.max(error[where]))
        impulse = float(np.linalg.norm(shove.impulse))
        add(f"{shove.name}, {impulse:g} N·s: distance after {scenario.recovery:g} s",
            f"below {1e3 * scenario.recovery_target:g} mm", 1e3, "mm", value, scenario.recovery_target)  # fmt: skip
    share = np.abs(recording.tau[np.isfinite(recording.tau).all(axis=1)]) / recording.effort_limits
    finite = bool(np.isfinite(recording.tau[len(recording.tau) // 2]).all()) and len(share) > 0
    add(
        "torques against their limits, largest",
        "at most 100 %",
        100.0,
        "%",
        float(share.max()) if finite else None,
        1.0,
    )
    return tuple(results)


def passed(results: Sequence[Result]) -> bool:
    """Whether all targets were met."""
    return bool(results) and all(result.passed for result in results)
