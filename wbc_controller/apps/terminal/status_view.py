"""Status of a robot as text for `wbc status`, with the next step after a fault."""

import re
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import starmap
from typing import Any, NamedTuple

import numpy as np
from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from wbc_controller.apps.terminal.session import Session
from wbc_controller.middleware.codec import JOINT_FIELDS
from wbc_controller.nodes.diagnostics.task_reports import describe_constraint
from wbc_controller.settings import Settings

_WINDOW = 2.0  # wall time, s
_TASK_PERIODS = 3.0  # for the first status, in periods of the diagnostics


class RobotStatus(NamedTuple):
    """Newest messages."""

    status: Any  # diagnostic_msgs/DiagnosticStatus of the controller
    rate: float  # per second of wall time; NaN if unknown
    tasks: Mapping[str, tuple[Any | None, Any | None]]  # value and reference of each task
    guard: str  # empty without a guard

    @property
    def values(self) -> dict[str, str]:
        """Values of the status by key."""
        return {value.key: value.value for value in self.status.values}


class StatusListener:
    """Subscribes to the status, and counts the cycles."""

    def __init__(self, session: Session, settings: Settings) -> None:
        self._session, self._settings = session, settings
        self._status: Any = None
        self._cycles: deque[tuple[float, int]] = deque()
        session.listen("controller", "state")
        session.listen("controller", "diagnostics", depth=1000)
        session.listen("guard", "state")
        self._task_topics = [place for place in session.topics if place[1] in ("task_value", "task_reference")]
        for place in self._task_topics:
            session.listen(*place)

    def wait_for_first(self) -> None:
        """Wait for a complete status; raise `NoAnswer` without a controller."""
        self._session.wait_for_controller()
        self._session.until(
            lambda: self.read_statuses() and len(self._cycles) > 1, "the controller has stopped publishing its status"
        )
        if self._session.mode().startswith(("active", "holding")):
            deadline = time.monotonic() + _TASK_PERIODS / self._settings.control.diagnostics_rate
            while time.monotonic() < deadline and not all(starmap(self._session.newest, self._task_topics)):
                time.sleep(0.02)

    def read_statuses(self) -> list[Any]:
        """Return the new statuses, oldest first."""
        now, statuses = time.monotonic(), list(self._session.statuses())
        for status in statuses:
            self._status = status
            self._cycles.append((now, int(next(value.value for value in status.values if value.key == "cycle"))))
        while len(self._cycles) > 2 and now - self._cycles[0][0] > _WINDOW:
            self._cycles.popleft()
        return statuses

    def newest(self) -> RobotStatus | None:
        """Return the status as of the last `read_statuses`, or None."""
        if self._status is None:
            return None
        (first, before), (last, after) = self._cycles[0], self._cycles[-1]
        guard = self._session.newest("guard", "state")
        newest = partial(self._session.newest, "controller")
        tasks = {name: (newest("task_value", name), newest("task_reference", name)) for name in self._settings.tasks}
        rate = (after - before) / (last - first) if last > first else float("nan")
        return RobotStatus(self._status, rate, tasks, "" if guard is None else str(guard.data))


_COLOURS = {0: "green", 1: "yellow", 2: "red"}
#: Checks and commands after a fault, by its code.
NEXT_STEPS: Mapping[str, str] = {
    "CLOCK": "check that exactly one node publishes the time and that the clock is not set; then reset, activate",
    "STALE_INPUT": "check that the robot's driver runs and its messages are in time (wbc status); then reset, activate",
    "ESTIMATE_LOST": "check the IMU and its mounting; let the robot stand still or suspend it; then reset, activate",
    "IMPLAUSIBLE_STATE": "suspend the robot; check the named joint or sensor; then reset, activate",
    "UNEXPLAINED_MOTION": "suspend the robot; check the order and signs of its effort commands; then reset, activate",
    "FALLING": "suspend the robot (mock robot: wbc send hold), then reset, activate, release",
    "FALLEN": "suspend the robot (mock robot: wbc send hold), then reset, activate, release",
    "NO_SOLUTION": "find the constraints in conflict with wbc replay; undo the last request; then reset, activate",
    "RELAXED": "reduce the request that caused the relaxed constraints; then reset, activate",
    "BAD_TORQUE": "examine the recording of the fault (wbc replay); then reset, activate",
    "ESTOP": "if safe: reset, then activate",
    "METHOD_FAILED": "correct the named class and method (traceback in the log); then restart the controller",
    "INTERNAL_ERROR": "report this defect of the controller with its log and the recording of the fault",
}
_FAULT_CODE = re.compile(rf"\b({'|'.join(NEXT_STEPS)})\b")


def next_step(state: str) -> str:
    """Return the next step after a fault, or an empty text."""
    found = _FAULT_CODE.search(state)
    return NEXT_STEPS[found[1]] if found else ""


def status_view(settings: Settings, robot: RobotStatus) -> RenderableType:
    """Return the status as a table."""
    table = Table.grid(padding=(0, 2))
    for fact in facts(robot).items():
        table.add_row(*fact)
    tasks = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for column in ("task", "type", "weight", "value", "reference", "error"):
        tasks.add_column(column, overflow="fold", justify="right" if column in ("weight", "error") else "left")
    for row in task_rows(settings, robot):
        tasks.add_row(*row[:-1], style="dim" if row.off else "")
    title = f"{robot.status.hardware_id}: {robot.status.message}"
    return Group(Text(title, style=f"bold {_COLOURS[robot.status.level]}"), table, tasks)


def facts(robot: RobotStatus) -> dict[str, str]:
    """Return further facts by subject."""
    values = robot.values
    late = values.get("deadlines_missed", "0")
    cycles = f"{robot.rate:.0f} per second" if np.isfinite(robot.rate) else "counting"
    found = {"cycles": cycles + (f", {late} deadlines missed" if late != "0" else "")}
    if "time/total/median" in values:
        found["cycle time"] = f"median {values['time/total/median']}, at most {values['time/total/max']}"
    ages = [f"{key.removeprefix('age/')} {_milliseconds(value)}" for key, value in values.items() if "age/" in key]
    found["ages"] = ", ".join(ages)
    if "walking/phase" in values:
        parts = [values["walking/phase"], f"{values['walking/steps']} steps", values.get("walking/velocity")]
        found["walking"] = ", ".join(filter(None, parts))
    found["guard"] = robot.guard or "no messages"
    if "binding" in values:
        found["binding"] = ", ".join(describe_constraint(name) for name, _ in binding(values)) or "none"
    for subject in ("audit", "infeasibility", "publishers"):
        known = [(key.partition("/")[2], value) for key, value in values.items() if key.startswith(f"{subject}/")]
        if known:
            found[subject] = "; ".join(f"{name} {value}" for name, value in known)
    if "recorder" in values:
        found["recorder"] = values["recorder"]
    advice = next_step(robot.status.message)
    if advice:
        found["next"] = advice
    return found


def binding(values: Mapping[str, str]) -> list[tuple[str, str]]:
    """Return the binding constraints with their multipliers, the largest first."""
    costs = [(key.removeprefix("cost/"), value) for key, value in values.items() if key.startswith("cost/")]
    return sorted(costs, key=lambda cost: -float(cost[1].partition(" ")[0]))


def _milliseconds(age: str) -> str:
    seconds = float(age.partition(" ")[0])
    return f"{1e3 * seconds:.1f} ms" if np.isfinite(seconds) else "never"


class TaskRow(NamedTuple):
    """One task in words; unknown values are empty."""

    name: str
    kind: str
    weight: str
    value: str
    reference: str
    error: str
    off: bool


def task_rows(settings: Settings, robot: RobotStatus) -> Iterator[TaskRow]:
    """Yield a row per task."""
    values = robot.values
    for name, task in settings.tasks.items():
        weight = values.get(f"task_weight/{name}")
        off = weight is not None and float(weight) <= 0.0
        value, reference = robot.tasks.get(name, (None, None))
        yield TaskRow(
            name=name,
            kind=task.type,
            weight="" if weight is None else "off" if off else weight,
            value="" if value is None else format_numbers(value, task.type),
            reference="" if reference is None or off else format_numbers(reference, task.type),
            error="" if off else values.get(f"task_error/{name}", ""),
            off=off,
        )


def format_numbers(content: Any, kind: str) -> str:
    """Return the numbers of a task's message in short form."""
    if kind in JOINT_FIELDS:
        joints: Sequence[float] = getattr(content, JOINT_FIELDS[kind])
        return f"{len(joints)} joints"
    parts = []
    if hasattr(content, "pose"):
        if kind != "frame_orientation":
            parts.append(_listed(content.pose.position, "xyz"))
        parts.append("quaternion " + _listed(content.pose.orientation, "xyzw"))
    elif hasattr(content, "wrench"):
        parts += [_listed(content.wrench.force, "xyz"), _listed(content.wrench.torque, "xyz")]
    else:
        parts.append(_listed(content.point if hasattr(content, "point") else content.vector, "xyz"))
    return " ".join(parts)


def _listed(vector: Any, axes: str) -> str:
    return re.sub(r"-(0\.0*)(?= |$)", r"\1", " ".join(f"{getattr(vector, axis):.3f}" for axis in axes))
