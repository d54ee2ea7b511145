"""Summary as a diagnostic_msgs/DiagnosticArray."""

import math
import statistics
from array import array
from collections import Counter, defaultdict
from collections.abc import Callable, Generator, Mapping, Sequence
from typing import Any

import numpy as np

from wbc_controller.controller.report import CycleReport
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware.codec import ERROR, OK, WARN, diagnostics
from wbc_controller.records import Disturbance, Mode, Solution
from wbc_controller.walking.footsteps import Velocity
from wbc_controller.walking.walker import Walker

_TIMES_PER_PIECE = 500  # sorted times per piece of the message
_CONTRADICTION = 0.5  # residual of contradictory contacts, m/s² or rad/s²
#: Units of a binding constraint's multiplier by its kind, as the cost has no unit.
_COST_UNITS = {"torque": "1/(N·m)", "cone": "1/N", "normal_force": "1/N", "motion": "1/(rad/s²)"}
_LEVELS = {**dict.fromkeys(Mode, WARN), Mode.INACTIVE: OK, Mode.ACTIVE: OK, Mode.FAULT: ERROR}


class _ReportWindow:
    """Summary of the reports since the last message; to free the reports themselves takes longer than a cycle."""

    def __init__(self, first: CycleReport) -> None:
        self.last = first
        self.count = 0
        self.times: defaultdict[str, array[float]] = defaultdict(lambda: array("d"))  # s, by stage
        self.relaxed: Counter[str] = Counter()  # cycles by relaxed limit
        self.refused: list[str] = []  # a sentence for each refused message


class StatusSummary:
    """Collector of the reports between two messages; `others` returns further values.

    The messages name the node with its namespace, because robots in one graph share the topic.
    """

    def __init__(
        self,
        node: str,
        hardware: str,
        scheduling: str = "",
        model: RobotModel | None = None,
        others: Callable[[], Mapping[str, str]] = dict,
    ) -> None:
        self._model = model
        self._name, self._hardware = f"{node.strip('/')}: control loop", hardware
        self._others = others
        self._scheduling = {"scheduling": scheduling} if scheduling else {}
        self._window: _ReportWindow | None = None
        self._taken = 0

    def add(self, report: CycleReport) -> None:
        """Add the report of a cycle."""
        window = self._window
        if window is None:
            window = self._window = _ReportWindow(report)
        window.last = report
        window.count += 1
        for stage, seconds in report.stage_seconds.items():
            window.times[stage].append(seconds)
        solution = report.solution
        if solution is not None and solution.relaxed:
            window.relaxed.update(solution.relaxed)
        if report.refused:
            window.refused += report.refused
        self._taken += report.inputs.requests.total

    def compose(self, wall: int, shortfalls: Sequence[str] = ()) -> Generator[None, None, Any]:
        """Compose and return the message with a header time, ns, and restart; yield after each piece.

        `shortfalls` contains a sentence for each task with a persistent error. The message is None without reports.
        """
        window, self._window = self._window, None
        if window is None:
            return None
        last, taken, contradiction = window.last, self._taken, 0.0
        values = self._scheduling | _cycle_values(window)
        yield
        sorted_so_far = 0
        for stage in last.stage_seconds:
            times = np.sort(window.times[stage]).tolist()
            values[f"time/{stage}/median"] = f"{1e6 * statistics.median(times):.0f} us"
            values[f"time/{stage}/max"] = f"{1e6 * times[-1]:.0f} us"
            sorted_so_far += len(times)
            if sorted_so_far >= _TIMES_PER_PIECE:
                sorted_so_far = 0
                yield
        if last.solution is not None:
            values |= _solution_values(last.solution)
            yield
            contradiction = last.solution.residuals.get("contact_motion", 0.0)
        values |= _check_values(last)
        friction = {} if last.result.references is None else last.result.references.friction
        values |= {
            f"friction/{name}": f"{share:.2f} of the configured one" for name, share in friction.items() if share < 1
        }
        relaxed = sorted(window.relaxed.items())
        warnings = [f"relaxed {what} in {count} of {window.count} cycles" for what, count in relaxed]
        if contradiction > _CONTRADICTION:
            warnings.append(f"redundant contacts contradict each other by {contradiction:.2g} m/s² (docs/contacts.md)")
        warnings += last.contested
        if last.audit is not None:
            warnings += last.audit.warnings
        values |= {f"refused/{i}": sentence for i, sentence in enumerate(window.refused)}
        warnings += [f"refused {sentence}" for sentence in window.refused]
        warnings += shortfalls
        disturbance = last.solution.disturbance if last.solution is not None else None
        if disturbance is not None and self._model is not None:
            values |= _disturbance_values(disturbance, self._model)
            if disturbance.at_bound:
                warnings.append(
                    "the estimated disturbance is at its bound (estimation.disturbance_share) at "
                    f"{', '.join(disturbance.at_bound)}: check masses and torque scales, or remove a constant push"
                )
        values |= last.inputs.estimate
        if "pose/contradiction" in last.inputs.estimate:
            warnings.append(last.inputs.estimate["pose/contradiction"])
        yield
        level = max(_LEVELS[last.mode], WARN if warnings else OK)
        if last.fault is not None:
            level = max(level, WARN)
            warnings.insert(0, f"{last.fault.code}: {last.fault.sentence}")
        if last.contested and last.command is not None:
            level = ERROR
        text = "; ".join([last.mode.value, *warnings])
        values["requests_taken"] = str(taken)
        values |= self._others()
        return diagnostics(wall, level, self._name, text, self._hardware, values)


def _disturbance_values(disturbance: Disturbance, model: RobotModel) -> dict[str, str]:
    """Return the estimated disturbance at the base, in its own axes, and at each joint."""
    values = {}
    if model.floating_base:
        force, moment = (" ".join(f"{part:.3f}" for part in disturbance.estimate[i : i + 3]) for i in (0, 3))
        values["disturbance/base"] = f"{force} N, {moment} N·m"
    torques = disturbance.estimate[model.v_index].tolist()
    for joint, torque, unit in zip(model.joints, torques, model.units, strict=True):
        values[f"disturbance/{joint}"] = f"{torque:.4f} {'N' if unit == 'm' else 'N·m'}"
    return values


def _cycle_values(window: _ReportWindow) -> dict[str, str]:
    last = window.last
    values = {
        "mode": last.mode.value,
        "cycle": str(last.cycle),
        "cycles": str(window.count),
        "deadlines_missed": str(last.deadlines_missed),
    }
    values |= {f"age/{name}": f"{age:.4f} s" for name, age in last.inputs.ages.items()}
    if last.result.references is not None:
        weights = last.result.references.weights
        values |= {f"task_weight/{name}": f"{weight:.5g}" for name, weight in weights.items()}
    return values


def _solution_values(solution: Solution) -> dict[str, str]:
    values = {f"task_error/{name}": f"{error:.5f}" for name, error in solution.task_errors.items()}
    values |= {f"residual/{name}": f"{residual:.2e}" for name, residual in solution.residuals.items()}
    values["binding"] = ", ".join(solution.binding) or "none"
    for name, cost in solution.binding.items():
        unit = _COST_UNITS.get(name.partition(":")[0], "1/(m/s²)")
        values[f"cost/{name}"] = f"{cost:.4g} {unit}"
    values["solver_iterations"] = str(solution.iterations)
    return values | {
        f"level/{i}": f"{', '.join(level.tasks) or 'no task'}: cost {level.cost:.4g}, "
        f"{level.iterations} iterations, {1e6 * level.seconds:.0f} us"
        for i, level in enumerate(solution.levels)
    }


def _check_values(last: CycleReport) -> dict[str, str]:
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


def walk_values(walker: Walker | None) -> dict[str, str]:
    """Return the values by key; none without a walker."""
    if walker is None:
        return {}
    values = {
        "walking/phase": walker.phase.value,
        "walking/steps": str(walker.steps),
        "walking/command": "none" if walker.command is None else _velocity_text(walker.command),
    }
    if walker.goal is not None:
        goal = walker.goal
        values["walking/goal"] = f"{goal.place.real:.3f} {goal.place.imag:.3f} m, {goal.heading:.3f} rad"
    plan = walker.plan()
    if plan is None:
        return values
    values["walking/velocity"] = _velocity_text(walker.velocity)
    values["walking/margin"] = f"{plan.margin:.4f} m"
    values["walking/dcm_error"] = f"{abs(plan.dcm - plan.wanted_dcm):.4f} m"
    if math.isfinite(plan.remaining):
        values["walking/touchdown"] = f"{plan.remaining:.3f} s"
    return values


def _velocity_text(velocity: Velocity) -> str:
    return f"{velocity.linear.real:.3f} {velocity.linear.imag:.3f} m/s, {velocity.turning:.3f} rad/s"
