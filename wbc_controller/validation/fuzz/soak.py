"""A long run: controller, mock robot and guard for minutes, with memory, faults and the machine's lateness watched."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from wbc_controller.middleware.codec import encode, header, message
from wbc_controller.middleware.topics import counterpart
from wbc_controller.nodes.processes import memory
from wbc_controller.validation.fuzz import DOMAIN
from wbc_controller.validation.fuzz.rig import MACHINE, Rig

#: Time between two looks at the processes, s, and between two setpoints.
_LOOK, _SETPOINT = 1.0, 3.0
#: Amplitude of the setpoints of the centre of mass, m.
_SWAY = 0.01
#: Share of the time after which the memory is to be flat, and by how much it may still grow, kB, and kB per minute.
_WARM_UP, _GROWTH, _SLOPE = 0.5, 1024, 256


@dataclass(slots=True)
class SoakResult:
    """The result of a long run.

    Attributes:
        seconds: its duration, s.
        memory: memory of each process at each look, kB.
        faults: what the controller and the guard said when they were not active or watching, each with the lateness of
            the machine in the second before, s, and the time that the fault allows, s.
        rate: commands per second that the user received.
        late: largest lateness of the machine, s.
    """

    seconds: float = 0.0
    memory: dict[str, list[int]] = field(default_factory=dict)
    faults: list[tuple[str, float, float]] = field(default_factory=list)
    rate: float = 0.0
    late: float = 0.0

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

    Args:
        robot: a robot that is shipped, or the path of a configuration.
        folder: for the logs.
        seconds: duration, s.
        domain: DDS domain.
        progress: called after each look.

    Raises:
        WbcError: if a process does not do what it should.
    """
    result = SoakResult()
    with Rig(robot, folder, domain) as rig:
        for name in ("mock", "guard", "controller"):
            rig.start(name)
            result.memory[name] = []
        rig.wait_for("mock", "controller", "guard")
        rig.activate()
        rig.until(lambda: rig.said("guard") == "watching", "the guard to watch")
        time.sleep(2.0 * rig.settings.safety.activation_ramp)
        sway = rig.advertise(counterpart(rig.inputs["setpoint/com"]))
        start = rig.centre_of_mass()
        rig.forget("controller", "guard")
        rig.lateness.forget()
        began = time.monotonic()
        due, side, count = began, 1.0, 0
        seen = began
        while time.monotonic() - began < seconds:
            if time.monotonic() >= due:
                due, side = due + _SETPOINT, -side
                x, y, z = (start + [0.0, side * _SWAY, 0.0]).tolist()
                point = message("geometry_msgs/msg/Point", x=x, y=y, z=z)
                sway(encode(message("geometry_msgs/msg/PointStamped", header=header(0, "world"), point=point)))
            time.sleep(_LOOK)
            now = time.monotonic()
            count += len(rig.heard("controller/joint_commands", seen))
            _look(rig, result, seen)
            seen = now
            result.seconds = now - began
            result.rate = count / result.seconds
            progress(result)
    return result


def _look(rig: Rig, result: SoakResult, since: float) -> None:
    """Note the memory of each process, and what was said; activate again after a fault."""
    late = rig.lateness.worst
    rig.lateness.forget()
    result.late = max(result.late, late)
    for name, kept in result.memory.items():
        kept.append(memory(rig.processes[name].pid))
    settings = rig.settings
    for node, usual, allowed in (
        ("controller", ("active",), settings.safety.state_timeout),
        ("guard", ("watching",), settings.guard.patience),
    ):
        said = [str(content.data) for _, content in rig.heard(f"{node}/state", since)]
        result.faults += [(text, late, allowed) for text in said if text not in usual]
    if rig.said("controller") not in ("", "active"):
        rig.activate()
        rig.forget("controller")
