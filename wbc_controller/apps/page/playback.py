"""Playback of a recording, with a time line."""

import bisect
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
import viser

from wbc_controller.apps.page.snapshot import FOLLOWING, Robot, Snapshot
from wbc_controller.apps.terminal.status_view import RobotStatus
from wbc_controller.errors import ConfigurationError
from wbc_controller.middleware.codec import decode
from wbc_controller.recording.cycle_layout import MODES, cycle_slots, reference_slots
from wbc_controller.recording.recording_file import RecordedCycle, Recording
from wbc_controller.records import Array, Reference, References

MAX_CYCLES = 20_000  # longer recordings are decimated
_PUSH_FORCE = 0.1  # in weights of the robot
_PUSH_GAP = 0.5  # s
_LONGEST_STEP = 0.5  # s; playback pauses without a page
_LONGEST_NUMBER = 18  # digits of a cycle number
_COLORS = {"fault": "#e03131", "contact": "#2f9e44", "push": "#f08c00", "mode": "#228be6"}
_SPEEDS = {"¼ ×": 0.25, "1 ×": 1.0, "4 ×": 4.0}


class Mark(NamedTuple):
    """Event of the recording: time since the start, s, kind (a key of `_COLORS`), and text."""

    time: float
    kind: str
    text: str


class Playback:
    """Snapshots of a recording by time; `ConfigurationError` without a robot state, or for another robot."""

    def __init__(self, recorded: Recording, robot: Robot) -> None:
        recorded.require_slots(cycle_slots(robot.model, robot.contacts) + reference_slots(robot.tasks, robot.contacts))
        self._recorded, self._robot = recorded, robot
        self.time, self.speed, self.playing = 0.0, 1.0, True  # present time, s, and recorded seconds per second
        self._now = time.monotonic()
        self._times: list[float] = []
        self._cycles: list[RecordedCycle] = []
        self.marks: list[Mark] = sorted(self._read_cycles(), key=lambda mark: mark.time)
        if not self._cycles:
            raise ConfigurationError(
                f"recording {recorded.path}: no robot state; record a controller with joint states"
            )
        self.duration = self._times[-1]
        self._statuses = list(self._read_statuses())

    def seek(self, seconds: float) -> None:
        """Set the present time, s."""
        self.time = min(max(0.0, seconds), self.duration)

    def snapshot(self) -> Snapshot:
        """Return the snapshot at the present time, and advance the time during playback."""
        now = time.monotonic()
        if self.playing:
            self.time += self.speed * min(now - self._now, _LONGEST_STEP)
            if self.time >= self.duration:
                self.time, self.playing = self.duration, False
        self._now = now
        cycle = self._cycles[max(0, bisect.bisect_right(self._times, self.time) - 1)]
        values, model = cycle.values, self._robot.model
        mode = MODES[int(cycle.scalar("mode"))].value
        moved = self._recorded.elapsed(cycle.time)
        fault = next((m.text for m in reversed(self.marks) if m.kind == "fault" and m.time <= moved + 1.0e-6), "")
        if cycle.scalar("fault") and fault:
            mode += f" {fault}"
        torques = values["tau"]
        at_joints = model.actuation.at_joints(np.array(torques)) if np.isfinite(torques).all() else None
        place = bisect.bisect_right(self._statuses, moved, key=itemgetter(0)) - 1
        return Snapshot(
            stamp=cycle.time,
            age=0.0,
            q=np.array(values["q"]),
            v=np.array(values["v"]),
            mode=mode,
            torques=at_joints,
            forces=self._forces(cycle),
            references=_references(cycle.references, self._robot) if mode.startswith(FOLLOWING) else None,
            status=self._statuses[place][1] if place >= 0 else None,
            silence=0.0,
        )

    def read_status(self) -> Sequence[str]:
        """Return no refusals."""
        return ()

    def _forces(self, cycle: RecordedCycle) -> dict[str, Array]:
        forces = {name: np.array(cycle.values[f"force/{name}"]) for name in self._robot.contacts}
        return {name: force for name, force in forces.items() if np.isfinite(force).all()}

    def _read_cycles(self) -> Iterator[Mark]:
        recorded, every = self._recorded, max(1, -(-self._recorded.count // MAX_CYCLES))
        weight = self._robot.model.mass * self._robot.model.gravity
        mode, active = "", frozenset[str]()  # mode, and contacts with forces in the last active cycle
        pushed = -_PUSH_GAP
        for number, cycle in enumerate(recorded.cycles()):
            if not cycle.scalar("has_state"):
                continue
            at = recorded.elapsed(cycle.time)
            if number % every == 0:
                self._times.append(at)
                self._cycles.append(cycle)
            former_mode, formerly_active = mode, active
            mode = MODES[int(cycle.scalar("mode"))].value
            if mode == "active":
                active = frozenset(self._forces(cycle))
            if former_mode and mode != former_mode:
                yield Mark(at, "mode", mode)
            if former_mode == mode == "active":
                yield from (Mark(at, "contact", f"{name} active") for name in sorted(active - formerly_active))
                yield from (Mark(at, "contact", f"{name} inactive") for name in sorted(formerly_active - active))
            unmodelled_force = float(np.linalg.norm(cycle.values["audit/force"]))
            if unmodelled_force > _PUSH_FORCE * weight and mode == "active":
                if at - pushed > _PUSH_GAP:
                    yield Mark(at, "push", f"unmodelled force of {unmodelled_force:.0f} N: push or collision")
                pushed = at
        for number, fault in recorded.faults.items():
            yield Mark(recorded.elapsed(recorded.events[number]["time"]), "fault", f"{fault.code}: {fault.sentence}")

    def _read_statuses(self) -> Iterator[tuple[float, RobotStatus]]:
        before, count = math.inf, 0
        node = f"{self._recorded.about['node'].strip('/')}: control loop"
        for topic, stamp, payload in self._recorded.messages():
            if not topic.name.endswith("/diagnostics"):
                continue
            for status in decode(payload, "diagnostic_msgs/msg/DiagnosticArray").status:
                if status.name == node:
                    values = {value.key: value.value for value in status.values}
                    now, number = self._recorded.elapsed(stamp), values.get("cycle", "")
                    cycle = int(number) if number.isdecimal() and len(number) <= _LONGEST_NUMBER else 0
                    rate = (cycle - count) / (now - before) if now > before else math.nan
                    yield now, RobotStatus(status, rate, {}, "")
                    before, count = now, cycle


class TimeLine:
    """Time line on the page, on the server's event loop."""

    def __init__(self, server: viser.ViserServer, playback: Playback) -> None:
        self._playback, gui = playback, server.gui
        self._loop = server.get_event_loop()
        with gui.add_folder("Recording"):
            self._play = gui.add_button("Pause")
            self._play.on_click(self._pressed)
            speed = gui.add_dropdown("Speed", tuple(_SPEEDS), initial_value="1 ×")
            speed.on_update(lambda event: setattr(playback, "speed", _SPEEDS[speed.value]))
            self._slider: Any = gui.add_slider("Time [s]", 0.0, max(0.01, round(playback.duration, 2)), 0.01, 0.0)
            self._slider.on_update(self._moved)
            gui.add_html(marks_html(playback))
            names = {f"{mark.time:.2f} s  {mark.text}"[:70]: mark.time for mark in playback.marks}
            if names:
                jump = gui.add_dropdown("Go to", tuple(names))
                jump.on_update(lambda event: self._go(names[jump.value]))

    def show(self) -> None:
        """Schedule an update to the present time."""
        self._loop.call_soon_threadsafe(self._show)

    def _show(self) -> None:
        self._play.label = "Pause" if self._playback.playing else "Play"
        shown = min(round(self._playback.time, 2), self._slider.max)
        if abs(shown - self._slider.value) > 0.005:
            self._slider.value = shown

    def _pressed(self, event: Any) -> None:
        playback = self._playback
        if not playback.playing and playback.time >= playback.duration:
            playback.seek(0.0)
        playback.playing = not playback.playing

    async def _moved(self, event: Any) -> None:
        if event.client_id is not None:
            self._go(self._slider.value)

    def _go(self, seconds: float) -> None:
        self._playback.playing = False
        self._playback.seek(seconds)


def marks_html(playback: Playback) -> str:
    """Return the marks along the time."""
    ticks = "".join(
        f'<i title="{escape(f"{mark.time:.2f} s: {mark.text}", quote=True)}" style="position:absolute;top:0;bottom:0;'
        f'width:3px;left:{100.0 * mark.time / max(playback.duration, 1e-9):.2f}%;background:{_COLORS[mark.kind]}"></i>'
        for mark in playback.marks
    )
    kinds = dict.fromkeys(mark.kind for mark in playback.marks)
    key = " · ".join(f'<span style="color:{_COLORS[kind]}">■</span> {kind}' for kind in kinds)
    return (
        '<div style="padding:2px 10px 6px;font-size:11px"><div style="position:relative;height:14px;'
        f'background:#8882;border-radius:2px">{ticks}</div>{key}</div>'
    )


def _references(reference_values: Mapping[str, Array], robot: Robot) -> References | None:
    if not reference_values:
        return None
    kinds = ("position", "velocity", "acceleration")
    names = [name for name in robot.tasks if f"position/{name}" in reference_values]
    tasks = {name: Reference(*(np.array(reference_values[f"{kind}/{name}"]) for kind in kinds)) for name in names}
    return References(tasks, {name: float(reference_values[f"weight/{name}"][0]) for name in tasks}, {})
