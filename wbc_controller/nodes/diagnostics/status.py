"""Summarises cycle reports as a diagnostic_msgs/DiagnosticArray."""

from __future__ import annotations

import statistics
from array import array
from collections import Counter
from collections.abc import Callable, Generator, Mapping, Sequence
from typing import Any

import numpy as np

from wbc_controller.controller.report import CycleReport
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware.codec import diagnostics
from wbc_controller.records import Array, Disturbance, Mode, Solution

#: Times that are sorted in one piece of the message, and those of one stage more.
_AT_ONCE = 500
_OK, _WARN, _ERROR = 0, 1, 2
#: Residual of the contacts' motion above which they contradict each other, m/s² or rad/s².
_CONTRADICTION = 0.5
_LEVELS = {
    Mode.INACTIVE: _OK,
    Mode.ACTIVE: _OK,
    Mode.HOLDING: _WARN,
    Mode.DAMPING: _WARN,
    Mode.STOPPED: _WARN,
    Mode.FAULT: _ERROR,
}


class _Span:
    """Summary of the reports since the last message.

    Only the newest report is kept: to free many at once, with their solutions, takes longer than a cycle.
    """

    def __init__(self, first: CycleReport) -> None:
        self.last = first
        self.count = 0
        self.names: tuple[str, ...] = ()  # stages of the newest report
        self.seconds = array("d")  # times of these stages, s, cycle by cycle since they last changed
        #: Stages and times of all runs of cycles with the same stages.
        self.runs: list[tuple[tuple[str, ...], array[float]]] = []
        self.relaxed: Counter[str] = Counter()  # number of cycles in which each limit was relaxed
        self.refused: list[str] = []  # a sentence for each refused message

    def times(self, stage: str) -> Array:
        """Return the times of a stage in all cycles that had it, s."""
        return np.concatenate(
            [np.frombuffer(seconds)[names.index(stage) :: len(names)] for names, seconds in self.runs if stage in names]
        )


class StatusSummary:
    """Collects the reports since the last message, and summarises them.

    Args:
        node: name of the node with its namespace, since two robots in one graph share the topic.
        scheduling: scheduling of the process; empty if unknown.
        model: the robot's model, for the disturbances at its joints; None to leave them out.
        recorder: returns the status of the recorder, by key.
    """

    def __init__(
        self,
        node: str,
        hardware: str,
        scheduling: str = "",
        model: RobotModel | None = None,
        recorder: Callable[[], Mapping[str, str]] = dict,
    ) -> None:
        self._model = model
        self._name, self._hardware = f"{node.strip('/')}: control loop", hardware
        self._recorder = recorder
        self._scheduling = {"scheduling": scheduling} if scheduling else {}
        self._span: _Span | None = None
        self._taken = 0

    def add(self, report: CycleReport) -> None:
        """Add the report of a cycle."""
        span = self._span
        if span is None:
            span = self._span = _Span(report)
        span.last = report
        span.count += 1
        stages = report.stage_seconds
        names = tuple(stages)
        if names != span.names:
            span.names, span.seconds = names, array("d")
            span.runs.append((names, span.seconds))
        span.seconds.extend(stages.values())
        solution = report.solution
        if solution is not None and solution.relaxed:
            span.relaxed.update(solution.relaxed)
        if report.refused:
            span.refused += report.refused
        self._taken += report.inputs.requests.total

    def compose(self, wall: int, short: Sequence[str] = ()) -> Generator[None, None, Any]:
        """Make the message of the reports so far piece by piece, and restart: yield None after each piece.

        Args:
            wall: time for the header, ns.
            short: a sentence for each task that stays short of its reference.

        Returns:
            The message; None without reports.
        """
        span, self._span = self._span, None
        if span is None:
            return None
        last, taken, missed = span.last, self._taken, 0.0
        values = self._scheduling | _of_cycles(span)
        yield
        sorted_so_far = 0
        for stage in last.stage_seconds:
            times = np.sort(span.times(stage)).tolist()
            values[f"time/{stage}/median"] = f"{1e6 * statistics.median(times):.0f} us"
            values[f"time/{stage}/max"] = f"{1e6 * times[-1]:.0f} us"
            sorted_so_far += len(times)
            if sorted_so_far >= _AT_ONCE:
                sorted_so_far = 0
                yield
        if last.solution is not None:
            values |= _of_solution(last.solution)
            yield
            missed = last.solution.residuals.get("contact_motion", 0.0)
        values |= _of_checks(last)
        warnings = [f"relaxed {what} in {count} of {span.count} cycles" for what, count in sorted(span.relaxed.items())]
        if missed > _CONTRADICTION:
            warnings.append(
                f"contacts contradict each other by {missed:.2g} m/s² (docs/contacts.md, redundant contacts)"
            )
        warnings += last.contested
        if last.audit is not None:
            warnings += last.audit.warnings
        values |= {f"refused/{i}": sentence for i, sentence in enumerate(span.refused)}
        warnings += [f"refused {sentence}" for sentence in span.refused]
        warnings += short
        beside = last.solution.disturbance if last.solution is not None else None
        if beside is not None and self._model is not None:
            values |= _of_disturbance(beside, self._model)
            if beside.at_bound:
                warnings.append(
                    "forces that the model lacks are at their bound (estimation.disturbance_share) at "
                    f"{', '.join(beside.at_bound)}: a wrong mass, torques that do not arrive as sent, or a steady push"
                )
        values |= last.inputs.estimate
        if "pose/contradiction" in last.inputs.estimate:
            warnings.append(last.inputs.estimate["pose/contradiction"])
        yield
        level = max(_LEVELS[last.mode], _WARN if warnings else _OK)
        if last.fault is not None:
            level = max(level, _WARN)
            warnings.insert(0, f"{last.fault.code}: {last.fault.sentence}")
        if last.contested and last.command is not None:
            level = _ERROR
        text = "; ".join([last.mode.value, *warnings])
        values["requests_taken"] = str(taken)
        values |= self._recorder()
        return diagnostics(wall, level, self._name, text, self._hardware, values)


def _of_disturbance(beside: Disturbance, model: RobotModel) -> dict[str, str]:
    """Return the estimated disturbance, by joint, and at the base in its own axes."""
    values = {}
    if model.floating_base:
        force, moment = (" ".join(f"{part:.3f}" for part in beside.estimate[i : i + 3]) for i in (0, 3))
        values["disturbance/base"] = f"{force} N, {moment} N·m"
    for joint, torque, unit in zip(model.joints, beside.estimate[model.v_index].tolist(), model.units, strict=True):
        values[f"disturbance/{joint}"] = f"{torque:.4f} {'N' if unit == 'm' else 'N·m'}"
    return values


def _per(constraint: str) -> str:
    """Return the unit of a binding constraint's multiplier, as the cost itself has no unit."""
    kind = constraint.partition(":")[0]
    return {"torque": "1/(N·m)", "cone": "1/N", "normal_force": "1/N", "motion": "1/(rad/s²)"}.get(kind, "1/(m/s²)")


def _of_cycles(span: _Span) -> dict[str, str]:
    """Return the key-value pairs of the loop and its inputs."""
    last = span.last
    values = {
        "mode": last.mode.value,
        "cycle": str(last.cycle),
        "cycles": str(span.count),
        "deadlines_missed": str(last.deadlines_missed),
    }
    values |= {f"age/{name}": f"{age:.4f} s" for name, age in last.inputs.ages.items()}
    if last.result.references is not None:
        weights = last.result.references.weights
        values |= {f"task_weight/{name}": f"{weight:.5g}" for name, weight in weights.items()}
    return values


def _of_solution(solution: Solution) -> dict[str, str]:
    """Return the key-value pairs of the solution."""
    values = {f"task_error/{name}": f"{error:.5f}" for name, error in solution.task_errors.items()}
    values |= {f"residual/{name}": f"{residual:.2e}" for name, residual in solution.residuals.items()}
    values["binding"] = ", ".join(solution.binding) or "none"
    values |= {f"cost/{name}": f"{cost:.4g} {_per(name)}" for name, cost in solution.binding.items()}
    values["solver_iterations"] = str(solution.iterations)
    return values | {
        f"level/{i}": f"{', '.join(level.tasks) or 'no task'}: cost {level.cost:.4g}, "
        f"{level.iterations} iterations, {1e6 * level.seconds:.0f} us"
        for i, level in enumerate(solution.levels)
    }


def _of_checks(last: CycleReport) -> dict[str, str]:
    """Return the key-value pairs of conflicts, the audit, and other publishers."""
    values: dict[str, str] = {}
    if last.fault is not None and last.fault.infeasibility is not None:
        why = last.fault.infeasibility
        values["infeasibility/conflict"] = ", ".join(why.conflict)
        values["infeasibility/smallest"] = ", ".join(why.smallest)
        values |= {f"infeasibility/slack/{name}": f"{slack:.4g} {why.units[name]}" for name, slack in why.slack.items()}
    if last.audit is not None:
        audit = last.audit
        values["audit/energy_residual"] = f"{audit.energy:.4f} W of {audit.throughput:.2f} W"
        values["audit/unmodelled_force"] = " ".join(f"{part:.3f}" for part in audit.force) + " N"
        values["audit/largest_unmodelled_torque"] = f"{float(np.max(np.abs(audit.joint_torques))):.4f} N·m"
    return values | {f"publishers/{topic}": names for topic, names in last.shared.items()}
