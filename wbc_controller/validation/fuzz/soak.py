"""A long run of controller, mock robot and guard: memory, faults and the lateness of the machine."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from wbc_controller.middleware.setpoints import setpoint_message
from wbc_controller.nodes.processes import memory
from wbc_controller.validation.fuzz import DOMAIN
from wbc_controller.validation.fuzz.lateness import MACHINE
from wbc_controller.validation.fuzz.robot_processes import RobotProcesses

#: Time between two looks at the processes, s, and between two setpoints.
_LOOK, _SETPOINT = 1.0, 3.0
#: Amplitude of the setpoints of the centre of mass, m.
_SWAY = 0.01
#: Share of the time after which the memory is to be flat, and by how much it may still grow, kB, and kB per minute.
_WARM_UP, _GROWTH, _SLOPE = 0.5, 1024, 256


@dataclass(slots=True)
class SoakResult:
    """The result of a long run."""

    seconds: float = 0.0
    memory: dict[str, list[int]] = field(default_factory=dict)  # memory of each process at each look, kB
    # what the controller and the guard said when they were not active or watching, each with the lateness of the
    # machine in the second before, s, and the time that the fault allows, s
    faults: list[tuple[str, float, float]] = field(default_factory=list)
    rate: float = 0.0  # commands per second that the user received
    late: float = 0.0  # largest lateness of the machine, s

    def growth(self, name: str) -> int:
        """Growth of a process's memory after the warm-up, kB: between the medians of two quarters of the rest."""
        kept = self.memory[name][int(_WARM_UP * len(self.memory[name])) :]
        quarter = max(1, len(kept) // 4)
        return int(np.median(kept[-quarter:]) - np.median(kept[:quarter]))

    def flat(self, name: str) -> bool:
        """Whether a process's memory stayed as it was after the warm-up."""
        return self.growth(name) <= _GROWTH + _SLOPE * (1.0 - _WARM_UP) * self.seconds / 60.0

    @property
    def own_faults(self) -> list[str]:
        """The faults that the machine did not cause."""
        return [said for said, late, allowed in self.faults if late < MACHINE * allowed]


def soak(
    robot: str,
    folder: Path,
    seconds: float,
    *,
    domain: int = DOMAIN,
    progress: Callable[[SoakResult], None] = lambda result: None,
) -> SoakResult:
    """Run everything for a while, with a robot that sways.

    Raises:
        WbcError: if a process does not do what it should.
    """
    result, names = SoakResult(), ("mock", "guard", "controller")
    with RobotProcesses(robot, folder, domain) as nodes:
        nodes.start_and_wait(*names)
        result.memory = {name: [] for name in names}
        nodes.activate()
        nodes.until(lambda: nodes.said("guard") == "watching", "the guard to watch")
        time.sleep(2.0 * nodes.settings.safety.activation_ramp)
        start = nodes.centre_of_mass()
        nodes.forget("controller", "guard")
        nodes.lateness.forget()
        began = seen = due = time.monotonic()
        side, count = 1.0, 0
        while time.monotonic() - began < seconds:
            if time.monotonic() >= due:
                due, side = due + _SETPOINT, -side
                there = start + [0.0, side * _SWAY, 0.0]
                nodes.user.send("setpoint", setpoint_message("geometry_msgs/msg/PointStamped", "com", there), "com")
            time.sleep(_LOOK)
            now = time.monotonic()
            count += len(nodes.heard("controller/joint_commands", seen))
            _look(nodes, result, seen)
            seen = now
            result.seconds = now - began
            result.rate = count / result.seconds
            progress(result)
    return result


def _look(nodes: RobotProcesses, result: SoakResult, since: float) -> None:
    """Note the memory of each process, and what was said; activate again after a fault."""
    late = nodes.lateness.worst
    nodes.lateness.forget()
    result.late = max(result.late, late)
    for name, kept in result.memory.items():
        kept.append(memory(nodes.processes[name].pid))
    settings = nodes.settings
    for node, usual, allowed in (
        ("controller", ("active",), settings.safety.state_timeout),
        ("guard", ("watching",), settings.guard.patience),
    ):
        said = [str(content.data) for _, content in nodes.heard(f"{node}/state", since)]
        result.faults += [(text, late, allowed) for text in said if text not in usual]
    if nodes.said("controller") not in ("", "active"):
        nodes.activate()
        nodes.forget("controller")
