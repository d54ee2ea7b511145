"""Long run of controller, mock robot and guard."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from wbc_controller.middleware.codec import setpoint_message
from wbc_controller.nodes.processes import memory
from wbc_controller.validation.fuzz.robot_processes import MACHINE, RobotProcesses

_CHECK_PERIOD, _SETPOINT_PERIOD = 1.0, 3.0  # s
_SWAY = 0.02  # of the centre of mass, to the left and back, m
_POINT = "geometry_msgs/msg/PointStamped"
#: Share of the time as warm-up, and largest growth of the memory afterwards, kB and kB per minute.
_WARM_UP, _MAX_GROWTH, _MAX_SLOPE = 0.5, 1024, 256


@dataclass(slots=True)
class SoakResult:
    """Result of a long run."""

    seconds: float = 0.0
    memory: dict[str, list[int]] = field(default_factory=dict)  # of each process at each check, kB
    # inactive states, each with the lateness of the machine in the last second and the time limit of the fault, s
    faults: list[tuple[str, float, float]] = field(default_factory=list)
    rate: float = 0.0  # received commands per second
    late: float = 0.0  # s

    def growth(self, name: str) -> int:
        """Return a process's growth after the warm-up, kB, between the medians of two quarters."""
        values = self.memory[name][int(_WARM_UP * len(self.memory[name])) :]
        quarter = max(1, len(values) // 4)
        return int(np.median(values[-quarter:]) - np.median(values[:quarter]))

    def flat(self, name: str) -> bool:
        """Return True if a process's memory was constant after the warm-up."""
        return self.growth(name) <= _MAX_GROWTH + _MAX_SLOPE * (1.0 - _WARM_UP) * self.seconds / 60.0

    @property
    def own_faults(self) -> list[str]:
        """Faults that were not caused by the machine."""
        return [text for text, late, allowed in self.faults if late < MACHINE * allowed]


def soak(robot: str, folder: Path, seconds: float, domain: int) -> Iterator[SoakResult]:
    """Run all nodes with a swaying robot, and yield the result so far; raise `WbcError` if a process fails."""
    result, names = SoakResult(), ("mock", "guard", "controller")
    with RobotProcesses(robot, folder, domain) as nodes:
        nodes.start_and_wait(*names)
        result.memory = {name: [] for name in names}
        nodes.activate()
        nodes.until(lambda: nodes.state_of("guard") == "watching", "the guard's watching state")
        time.sleep(2.0 * nodes.settings.safety.activation_ramp)
        nodes.clear("controller", "guard")
        nodes.lateness.worst = 0.0
        began = checked_at = due = time.monotonic()
        side, count = 1.0, 0
        while time.monotonic() - began < seconds:
            if time.monotonic() >= due:
                way = setpoint_message(_POINT, "com", np.array([0.0, side * _SWAY, 0.0]), frame="com/reference")
                nodes.user.send("setpoint", way, "com")
                due, side = due + _SETPOINT_PERIOD, -side
            time.sleep(_CHECK_PERIOD)
            now = time.monotonic()
            count += len(nodes.messages_since("controller/joint_commands", checked_at))
            _check(nodes, result, checked_at)
            checked_at = now
            result.seconds = now - began
            result.rate = count / result.seconds
            yield result


def _check(nodes: RobotProcesses, result: SoakResult, since: float) -> None:
    late = nodes.lateness.worst
    nodes.lateness.worst = 0.0
    result.late = max(result.late, late)
    for name, values in result.memory.items():
        values.append(memory(nodes.processes[name].pid))
    settings = nodes.settings
    for node, usual, allowed in (
        ("controller", ("active",), settings.safety.state_timeout),
        ("guard", ("watching",), settings.guard.patience),
    ):
        states = [str(content.data) for _, content in nodes.messages_since(f"{node}/state", since)]
        result.faults += [(text, late, allowed) for text in states if text not in usual]
    if nodes.state_of("controller") not in ("", "active"):
        nodes.activate()
        nodes.clear("controller")
