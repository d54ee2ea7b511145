"""Verdict of a demo: comparison with the targets."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pinocchio as pin

from wbc_controller.apps.demo.director import Director, Windows
from wbc_controller.apps.demo.scenario import Scenario
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.recording.report.run_data import Result, RunData, heading, mean_velocity
from wbc_controller.records import Array

_STANDING = 0.005  # largest mean velocity after a stop, m/s and rad/s


def reference_of(run: RunData, director: Director) -> Array:
    """Return the reference of the centre of mass, (n, 3) in m; NaN before the first."""
    reference = np.full_like(run.com, np.nan)
    for start, trajectory in director.references:
        for i in np.flatnonzero(run.start + run.time >= start):
            now = run.start + float(run.time[i])
            reference[i] = np.nan if trajectory is None else trajectory.sample(now).position
    return reference


def distances_to_targets(run: RunData, director: Director, model: RobotModel) -> dict[str, Array]:
    """Return the distance of each hand from its target, (n,) in m, by name of the task."""
    data = model.pinocchio.createData()

    def distance(q: Array, frame: int, target: Array) -> float:
        pin.framesForwardKinematics(model.pinocchio, data, np.array(q))
        return float(np.linalg.norm(data.oMf[frame].translation - target))

    return {task: np.array([distance(q, *place) for q in run.q]) for task, place in director.targets.items()}


def judge(
    run: RunData, scenario: Scenario, windows: Windows, distances: Mapping[str, Array], weight: float
) -> tuple[Result, ...]:
    """Compare a run with its targets; `windows` by phase, `distances` of the hands, `weight` in N."""
    error = np.linalg.norm(run.com - run.com_reference, axis=1)

    def within(name: str, values: Array, after: float = 0.0) -> Array:
        if name not in windows:
            return values[:0]
        (start, end), time = windows[name], run.time + run.start
        return values[(time >= start + after) & (time <= end)]

    results = []
    # With inexact motors the disturbance observer assigns some of the weight to a force on the base.
    for label, wrenches, disturbance in (
        ("QP", run.contact_wrenches, run.disturbance),
        ("MuJoCo", run.true_wrenches, np.zeros(len(run.time))),
    ):
        if not wrenches:  # a fixed base carries the weight
            continue
        force = disturbance + np.sum([values[:, 2] for values in wrenches.values()], axis=0)
        deviation, limit = np.abs(within("stand", force) / weight - 1.0), scenario.force_target
        measured = f"{100.0 * np.max(deviation):.3f} % deviation" if len(deviation) else "not reached"
        good = len(deviation) > 0 and bool(np.max(deviation) <= limit)
        results.append(Result(f"stand: vertical force, {label}", f"weight ± {100.0 * limit:g} %", measured, good))
    for move in scenario.moves:
        squares = within(move.name, error) ** 2
        rms = np.sqrt(np.mean(squares, keepdims=True)) if len(squares) else squares
        results.append(_distance(f"{move.name}: RMS error", rms, move.target_rms))
    for reach in scenario.reaches:
        distance = within(f"reach {reach.task}", distances.get(reach.task, error))
        results.append(_distance(f"reach: {reach.task} error", distance[-1:], reach.target))
    for shove in scenario.shoves:
        name = f"{shove.name} {np.linalg.norm(shove.impulse):g} N·s"
        peak = within(shove.name, error)
        result = _distance(name, within(shove.name, error, scenario.recovery), scenario.recovery_target)
        if len(peak):
            result = replace(result, measured=f"{result.measured} (peak {1e3 * np.max(peak):.0f})")
        results.append(replace(result, target=f"{result.target} in {scenario.recovery:g} s"))
    results += _walked(run, scenario, windows)
    if run.audit:
        calm = ["stand", *(move.name for move in scenario.moves)]
        calm += [f"reach {reach.task}" for reach in scenario.reaches]
        warnings = np.concatenate([within(name, run.audit["warnings"]) for name in calm])
        measured = f"{np.count_nonzero(warnings)} of {len(warnings)} samples" if len(warnings) else "not reached"
        good = len(warnings) > 0 and not warnings.any()
        results.append(Result("model audit: false warnings", "none", measured, good))
    share = np.abs(run.tau) / run.effort_limits
    sent = share[~np.isnan(share).all(axis=1)]  # without the samples before the first command
    measured = f"{100.0 * np.max(sent):.1f} %" if len(sent) else "no command"
    good = len(sent) > 0 and bool(np.max(sent) <= 1.0)
    results.append(Result("largest torque / limit", "at most 100 %", measured, good))
    return tuple(results)


def _walked(run: RunData, scenario: Scenario, windows: Windows) -> list[Result]:
    wanted = {walk.name: (walk.velocity, walk.target) for walk in scenario.walks}
    if wanted:
        wanted["stop"] = (0.0, 0.0, 0.0), _STANDING
    results = []
    for name, (velocity, limit) in wanted.items():
        text = f"{', '.join(f'{each:g}' for each in velocity)} ± {limit:g} m/s, rad/s"
        if name not in windows:
            results.append(Result(name, text, "not reached", False))
            continue
        way = np.column_stack([run.time + run.start, run.q[:, :2], [heading(q) for q in run.q]])
        mean = mean_velocity(way, *windows[name])
        good = bool(np.abs(mean - velocity).max() < limit)
        results.append(Result(name, text, ", ".join(f"{each:.3f}" for each in np.round(mean, 3) + 0.0), good))
    return results


def _distance(name: str, values: Array, limit: float) -> Result:
    """Compare the largest distance, m, with a limit; NaN or no values miss it."""
    measured = f"{1e3 * np.max(values):.2f} mm" if len(values) else "not reached"
    return Result(name, f"below {1e3 * limit:g} mm", measured, len(values) > 0 and bool(np.max(values) < limit))
