"""Comparison of two configurations on a recording."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from wbc_controller.controller.result import CycleResult
from wbc_controller.controller.visualization.page_report import PageReport, Plot, write_page
from wbc_controller.controller.visualization.plots import Line, Panel, line_panels
from wbc_controller.controller.visualization.tables import Table, as_text
from wbc_controller.errors import ConfigurationError
from wbc_controller.recording.cycle_layout import MODES
from wbc_controller.recording.recording_file import Recording
from wbc_controller.recording.replay.cycle_replay import Replay, ReplayedCycle
from wbc_controller.records import Array
from wbc_controller.settings.config import Config

_SHOWN = 8  # actuators with the largest differences


@dataclass
class Comparison:
    """Results of both."""

    actuators: tuple[str, ...]  # names, in the order of the torques
    limits: Array  # effort limits, (na,) in N·m
    time: list[float] = field(default_factory=list)  # times of the cycles since the first, s
    recorded: list[Array] = field(default_factory=list)  # recorded torques, (na,) per cycle
    other: list[Array] = field(default_factory=list)  # torques of the other configuration
    #: Norms of the task errors of both, per cycle and task.
    errors: list[tuple[Mapping[str, float], Mapping[str, float]]] = field(default_factory=list)
    #: Number of cycles by binding constraint, per configuration.
    binding: tuple[Counter[str], Counter[str]] = field(default_factory=lambda: (Counter(), Counter()))
    mode_differences: int = 0  # number of cycles with different modes

    def add(self, time: float, solved: ReplayedCycle, other: CycleResult) -> None:
        """Add a cycle."""
        self.time.append(time)
        self.recorded.append(solved.result.tau)
        self.other.append(other.tau)
        self.errors.append((dict(solved.result.task_errors), dict(other.task_errors)))
        self.mode_differences += other.mode is not MODES[int(solved.cycle.scalar("mode"))]
        for counts, result in zip(self.binding, (solved.result, other), strict=True):
            counts.update(result.binding.keys())

    def _mean_error(self, task: str, side: int) -> float:
        known = [pair[side][task] for pair in self.errors if task in pair[side]]
        return float(np.mean(known)) if known else float("nan")

    @property
    def _difference(self) -> Array:
        return np.array(self.other) - np.array(self.recorded)

    def _largest_differences(self) -> list[int]:
        largest = np.max(np.abs(self._difference), axis=0)
        return [int(i) for i in np.argsort(-largest)[:_SHOWN]]

    def __str__(self) -> str:
        difference, recorded, other = self._difference, np.array(self.recorded), np.array(self.other)
        torques = [
            (
                self.actuators[i], f"{_rms(recorded[:, i]):.2f}", f"{_rms(other[:, i]):.2f}",
                f"{_rms(difference[:, i]):.3f}", f"{np.max(np.abs(difference[:, i])):.3f}",
                f"{100.0 * np.max(np.abs(other[:, i])) / self.limits[i]:.0f} %",
            )
            for i in self._largest_differences()
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
        return as_text(self._heading(), tables)

    def plot(self, path: Path, title: str) -> None:
        """Write both over time as one offline HTML file; errors as for `write_page`."""
        time, recorded, other = np.array(self.time), np.array(self.recorded), np.array(self.other)
        worst = self._largest_differences()
        torques = {"difference [N·m]": self._difference, "recorded torque [N·m]": recorded, "other torque [N·m]": other}
        panels = [
            Panel(axis, [Line(self.actuators[i], time, values[:, i]) for i in worst])
            for axis, values in torques.items()
        ]
        lines = [
            Line(f"{name}: largest of all", time, 100.0 * np.max(np.abs(values) / self.limits, axis=1))
            for name, values in (("recorded", recorded), ("other", other))
        ]
        panels.append(Panel("torque / limit [%]", lines, from_zero=True))
        caption = f"The {len(worst)} actuators with the largest differences, and the largest torque of all actuators."
        plots = [Plot("torques", "Torques", caption, line_panels(panels, height=800), over_time=True)]
        write_page(PageReport(title=title, kind="wbc replay", verdict=self._heading(), plots=plots), path)

    def _heading(self) -> str:
        return (
            f"{len(self.time)} cycles, each solved in its recorded state; different modes in {self.mode_differences} "
            f"cycles, largest torque difference {np.max(np.abs(self._difference)):.3g} N·m"
        )


def compare(recorded: Recording, config: Config) -> Comparison:
    """Solve a recording with its own and another configuration of the same joints.

    Other joints, or a recording without commands, raise `ConfigurationError`.
    """
    own, other = Replay(recorded), Replay(recorded, config)
    model = own.controller.model
    first, second = ((m.joints, m.actuators, m.nq) for m in (model, other.controller.model))
    if first != second:
        raise ConfigurationError(
            f"{config.source}: the joints must be those of the recording: {', '.join(model.joints)}"
        )
    result = Comparison(model.actuators, model.effort_limits)
    for a, b in zip(own.run(), other.run(), strict=True):
        if a.result.command is not None or b.result.command is not None:
            result.add(recorded.elapsed(a.cycle.time), a, b.result)
    if not result.time:
        raise ConfigurationError(f"recording {recorded.path}: no cycle can be compared: no command was sent")
    return result


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
