"""Replay of cycles, bit for bit, and with another configuration."""

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from wbc_controller.controller.cycle import ControlCycle
from wbc_controller.controller.report import CycleInputs
from wbc_controller.controller.result import CycleResult
from wbc_controller.controller.visualization.page_report import PageReport, Plot, write_page
from wbc_controller.controller.visualization.plots import Line, Panel, line_panels
from wbc_controller.controller.visualization.tables import Table, as_text
from wbc_controller.errors import ConfigurationError
from wbc_controller.recording.cycle_layout import MODES, cycle_slots
from wbc_controller.recording.json_records import from_json, require_types
from wbc_controller.recording.recording_file import RecordedCycle, Recording
from wbc_controller.records import Array, RobotState, freeze, frozen
from wbc_controller.settings import Settings
from wbc_controller.settings.config import Config

_MEMORY = {"cycle": int, "settings": str, "memory": Mapping[str, Any]}  # types of the topic ``memory``
_SHOWN = 8  # actuators with the largest differences


@dataclass(frozen=True, slots=True)
class ReplayedCycle:
    """Replayed cycle."""

    cycle: RecordedCycle
    result: CycleResult
    exact: bool  # True after a complete memory: the result must be equal bit for bit

    @property
    def is_identical(self) -> bool:
        """True if mode, torques and accelerations equal the recorded ones bit for bit."""
        cycle, result = self.cycle, self.result
        tau = result.command.tau.tobytes() if result.command is not None else None
        v_dot = result.solution.v_dot.tobytes() if result.solution is not None else None
        recorded_tau = cycle.values["tau"].tobytes() if cycle.scalar("has_command") else None
        recorded_v_dot = cycle.values["v_dot"].tobytes() if cycle.scalar("has_solution") else None
        recorded = int(cycle.scalar("mode")), recorded_tau, recorded_v_dot
        return (MODES.index(result.mode), tau, v_dot) == recorded

    @property
    def difference(self) -> float:
        """Largest torque difference, N·m; infinite if only one command exists."""
        recorded = bool(self.cycle.scalar("has_command"))
        if self.result.command is None or not recorded:
            return np.inf if recorded or self.result.command is not None else 0.0
        return float(np.max(np.abs(self.result.command.tau - self.cycle.values["tau"])))


class Replay:
    """Run of a controller on a recording, optionally with another configuration of the same joints.

    An invalid configuration or layout raises `ConfigurationError`.
    """

    def __init__(self, recorded: Recording, config: Config | None = None) -> None:
        self.recorded = recorded
        self.skipped = 0  # cycles without replay, because the memory before them is unknown
        self._other = config is not None
        # The controller after the last cycle.
        self.controller = ControlCycle(recorded.config if config is None else config, preflight=False)
        if config is None:
            recorded.require_slots(cycle_slots(self.controller.model, self.controller.contacts))

    def run(self, first: int | None = None, last: int | None = None) -> Iterator[ReplayedCycle]:
        """Replay the cycles from `first` to `last` (None: all), from the last memory before them.

        A memory that does not fit the controller raises `ConfigurationError`.
        """
        recorded = self.recorded
        begin = max((number for number in recorded.memories if first is not None and number <= first), default=0)
        expected: int | None = None
        state: RobotState | None = None
        exact = True
        self.skipped = 0
        for cycle in recorded.cycles():
            if last is not None and cycle.number > last:
                return
            if cycle.number < begin:
                continue
            event = recorded.events.get(cycle.number)
            lost = event is None and cycle.scalar("has_event")  # because the controller was killed
            apart = event is not None and event.get("apart", False)
            known = cycle.number == expected and not apart  # else first cycle, or after a gap or an unknown state
            if lost or not (known or cycle.number in recorded.memories):
                self.skipped += 1
                expected = None
                continue
            if not known:
                exact = self._restore_memory(cycle.number)
            expected = cycle.number + 1
            if not (cycle.scalar("same_state") and state is not None):
                state = _state(cycle)
            with recorded.translated_errors(f"cycle {cycle.number}"):
                result = self._cycle(cycle, state)
            yield ReplayedCycle(cycle, result, exact)

    def _restore_memory(self, number: int) -> bool:
        with self.recorded.translated_errors(f"the memory before cycle {number}"):
            content = from_json(self.recorded.memories[number])
            require_types(content, _MEMORY, "it")
            memory = content["memory"]
            if self._other:
                memory = _convert_memory(self.controller, memory)
                settings: Settings = self.controller.config.settings
            else:
                settings = self.recorded.parse_configuration(content["settings"]).settings
            self.controller.recall(memory, settings)
            return memory["qp"] is not None or number == 0

    def _cycle(self, cycle: RecordedCycle, state: RobotState | None) -> CycleResult:
        event = self.recorded.events.get(cycle.number, {})
        if "settings" in event and not self._other:
            self.controller.live.replace_all(self.recorded.parse_configuration(event["settings"]).settings)
        velocity = cycle.values["joint_velocity"] if cycle.scalar("has_joint_velocity") else None
        sent = event.get("torques sent")
        sensors = [name for name in self.controller.contacts if f"touching/{name}" in cycle.values]
        touching = {name: cycle.scalar(f"touching/{name}") for name in sensors}
        inputs = CycleInputs(
            now=cycle.scalar("now"),
            state=state,
            joint_velocity=velocity,
            problem=event.get("problem"),
            requests=tuple(event.get("requests", ())),
            changes=tuple(tuple(each) for each in event.get("changes", ())),
            touching={name: value > 0.0 for name, value in touching.items() if not math.isnan(value)},
            torques_sent=None if sent is None else frozen(np.array(sent)),
        )
        return self.controller.cycle(inputs)


def _state(cycle: RecordedCycle) -> RobotState | None:
    if not cycle.scalar("has_state"):
        return None
    return RobotState(cycle.stamp, freeze(np.array(cycle.values["q"])), freeze(np.array(cycle.values["v"])))


def _convert_memory(controller: ControlCycle, memory: Mapping[str, Any]) -> dict[str, object]:
    fresh, plans = controller.memory(), controller.live.newest.board.tasks
    own, taken = fresh["board"], memory["board"]
    # Empty before the first cycle; new tasks get theirs when enabled.
    trajectories = {task: taken["_trajectories"][task] for task in plans if task in taken["_trajectories"]}
    board = {**taken, "_weights": own["_weights"], "_tuning": own["_tuning"], "_trajectories": trajectories}
    for name in ("_weight_ramps", "_contact_ramps", "_friction_ramps", "_enabled"):
        board[name] = {key: taken[name].get(key, value) for key, value in own[name].items()}
    ramps = board["_weight_ramps"]
    for name, plan in plans.items():
        ramp = ramps[name]
        if ramp.after > 0.0 and plan.weight > 0.0:
            ramps[name] = replace(ramp, after=plan.weight)
    if fresh["walker"] is not None and memory["walker"] is not None:
        fresh["walker"] = memory["walker"]
    return {**fresh, "qp": None, "board": board, "supervisor": memory["supervisor"]}


class Comparison:
    """Results of a recording, solved in its recorded states with its own and another configuration."""

    def __init__(self, recorded: Recording, config: Config) -> None:
        """Solve all cycles with both; other joints, or a recording without commands, raise `ConfigurationError`."""
        own, other = Replay(recorded), Replay(recorded, config)
        model = own.controller.model
        first, second = ((m.joints, m.actuators, m.nq) for m in (model, other.controller.model))
        if first != second:
            raise ConfigurationError(
                f"{config.source}: the joints must be those of the recording: {', '.join(model.joints)}"
            )
        self.actuators, self.limits = model.actuators, model.effort_limits  # names, and effort limits, (na,) in N·m
        #: Norms of the task errors of both, per cycle and task.
        self.errors: list[tuple[Mapping[str, float], ...]] = []
        #: Number of cycles by binding constraint, per configuration.
        self.binding: tuple[Counter[str], ...] = (Counter(), Counter())
        times, torques, mode_differences = [], [], 0
        for a, b in zip(own.run(), other.run(), strict=True):
            results = a.result, b.result
            if a.result.command is None and b.result.command is None:
                continue
            times.append(recorded.elapsed(a.cycle.time))
            torques.append([result.tau for result in results])
            self.errors.append(tuple(dict(result.task_errors) for result in results))
            mode_differences += b.result.mode is not MODES[int(a.cycle.scalar("mode"))]
            for counts, result in zip(self.binding, results, strict=True):
                counts.update(result.binding.keys())
        if not times:
            raise ConfigurationError(f"recording {recorded.path}: no cycle can be compared: no command was sent")
        self.time = np.array(times)  # of the cycles since the first, (n,) in s
        self.recorded, self.other = np.swapaxes(torques, 0, 1)  # torques of both, (n, na) in N·m
        self.difference = self.other - self.recorded
        largest = np.max(np.abs(self.difference), axis=0)
        self._worst = np.argsort(-largest)[:_SHOWN].tolist()  # actuators
        self._heading = (
            f"{len(times)} cycles, each solved in its recorded state; different modes in {mode_differences} cycles, "
            f"largest torque difference {np.max(largest):.3g} N·m"
        )

    def _mean_error(self, task: str, side: int) -> float:
        known = [pair[side][task] for pair in self.errors if task in pair[side]]
        return float(np.mean(known)) if known else float("nan")

    def __str__(self) -> str:
        recorded, other, difference = self.recorded, self.other, self.difference
        torques = [
            (
                self.actuators[i], f"{_rms(recorded[:, i]):.2f}", f"{_rms(other[:, i]):.2f}",
                f"{_rms(difference[:, i]):.3f}", f"{np.max(np.abs(difference[:, i])):.3f}",
                f"{100.0 * np.max(np.abs(other[:, i])) / self.limits[i]:.0f} %",
            )
            for i in self._worst
        ]  # fmt: skip
        names = dict.fromkeys(name for pair in self.errors for each in pair for name in each)
        tasks = [(name, *(f"{self._mean_error(name, side):.4g}" for side in (0, 1))) for name in names]
        bound = [
            (name, *(str(counts[name]) for counts in self.binding))
            for name in sorted({*self.binding[0], *self.binding[1]})
        ]
        columns = ("torques, N·m", "RMS", "other RMS", "RMS of diff.", "largest diff.", "other, of limit")
        tables = [
            Table(columns, tuple(torques)),
            Table(("task", "mean error", "other"), tuple(tasks)),
            Table(("binding constraint", "cycles", "other"), tuple(bound)),
        ]
        return as_text(self._heading, tables)

    def plot(self, path: Path, title: str) -> None:
        """Write both over time as one offline HTML file; errors as for `write_page`."""
        torques = {"difference [N·m]": self.difference, "recorded torque [N·m]": self.recorded}
        torques["other torque [N·m]"] = self.other
        panels = [
            Panel(axis, [Line(self.actuators[i], self.time, values[:, i]) for i in self._worst])
            for axis, values in torques.items()
        ]
        lines = [
            Line(f"{name}: largest of all", self.time, 100.0 * np.max(np.abs(values) / self.limits, axis=1))
            for name, values in (("recorded", self.recorded), ("other", self.other))
        ]
        panels.append(Panel("torque / limit [%]", lines, from_zero=True))
        caption = (
            f"The {len(self._worst)} actuators with the largest differences, and the largest torque of all actuators."
        )
        plots = [Plot("torques", "Torques", caption, line_panels(panels, height=800), over_time=True)]
        write_page(PageReport(title=title, kind="wbc replay", verdict=self._heading, plots=plots), path)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
