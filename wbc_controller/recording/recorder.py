"""The flight recorder: what came in, what was decided, and what went out, of every cycle, to a process that writes it.

Of each cycle the loop's thread joins the numbers, and sends them with the messages of the cycle through a pipe: that is
all that it does. What is rare (requests, refusals, faults, changes of settings, and every two seconds all that the
controller remembers) a thread of its own turns to JSON.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import json
import logging
import os
import platform
import queue
import struct
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from wbc_controller.controller.build.robot_description import read_urdf
from wbc_controller.controller.controller import Controller
from wbc_controller.controller.live_settings import LivePart
from wbc_controller.controller.memory import Taped
from wbc_controller.middleware.codec import TYPES, encode, message
from wbc_controller.middleware.transports.transport import Transport
from wbc_controller.recording.cycle_layout import (
    FORMAT,
    MODES,
    ReferencesRow,
    Row,
    Slot,
    dumped,
    groups,
    layout_of,
    references_of,
)
from wbc_controller.recording.json_records import to_json
from wbc_controller.recording.recording_transport import RecordingTransport
from wbc_controller.recording.writer import CYCLE, FRAME, PINNED, TOPICS, TRIGGER, WITH_THE_CYCLE
from wbc_controller.recording.writer_process import WriterProcess, frame
from wbc_controller.records import CycleReport, Fault, Mode
from wbc_controller.settings import Settings
from wbc_controller.settings.config import Config

_log = logging.getLogger(__name__)

#: Time between two copies of the controller's memory, s: a replay begins at one of them.
_SNAPSHOT = 2.0
#: Cycles that are sent together: what is done for several in a row costs half as much.
_TOGETHER = 8
#: Most bytes of incoming messages that wait for the end of a cycle, and twice the most messages.
_WAITING, _MOST = 8 << 20, 20_000
#: Most bytes of a topic that are recorded of the cycles that are sent together, where it is more than one message: who
#: floods a topic must not cost the recording its cycles.
_SHARE = 64 << 10
#: Largest message that is recorded, bytes: larger ones are turned away unread on every topic, and the events say so.
_LARGEST = 1 << 20
#: Time for which the same warning is not repeated, s.
_SILENCE = 10.0
#: What is said where there is no recorder.
NOT_RECORDED = "nothing is recorded: recorder.seconds is 0"
#: Topics of the recorder itself, below the controller's name.
OWN = "recording"
#: Packages on which the last bit of a torque depends.
_SOFTWARE = (
    "wbc_controller", "numba", "llvmlite", "numpy", "scipy", "pin", "daqp", "osqp", "proxsuite", "qpsolvers", "coal",
)  # fmt: skip


def folder_of(settings: Settings) -> Path:
    """Folder of the recordings that faults leave."""
    if settings.recorder.folder:
        return Path(settings.recorder.folder).expanduser()
    state = os.environ.get("XDG_STATE_HOME") or str(Path("~/.local/state").expanduser())
    return Path(state) / "wbc_controller"


def software() -> dict[str, str]:
    """Versions of what the torques depend on."""
    versions = {"python": platform.python_version(), "machine": platform.machine()}
    for name in _SOFTWARE:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            versions[name] = importlib.metadata.version(name)
    return versions


class Recorder:
    """Records the cycles of one loop."""

    def __init__(self, settings: Settings, file: Path | None = None, *, patient: bool = False, name: str = "") -> None:
        """Start the process that writes.

        Args:
            settings: of the robot.
            file: takes all of the run; None keeps the last seconds alone.
            patient: wait for the process rather than lose a part: for runs in simulated time.
            name: of the robot, for the names of files.
        """
        seconds = settings.recorder.seconds
        self._all_of_it = file is not None
        self._kept = f"all is recorded in {str(file)!r}" if file is not None else f"the last {seconds:g} s are kept"
        folder = str(folder_of(settings)) if seconds > 0.0 else None
        plan = {
            "file": str(file) if file is not None else None,
            "folder": folder,
            "seconds": seconds,
            "files": settings.recorder.files,
            "name": name or "robot",
        }
        self._process = WriterProcess(plan, patient=patient)
        self._settings = settings
        self._topics: list[list[Any]] = []
        #: What stands before a message in the pipe, and the message, of all that came and went since the last batch.
        self._messages: list[bytes] = []
        self._waiting = 0
        self._taken: dict[int, int] = {}  # bytes that wait, by channel
        self._left_out: Counter[int] = Counter()  # messages by channel, since the last event
        self._done: deque[bytes] = deque()  # frames of the thread
        self._jobs: queue.SimpleQueue[Callable[[], bytes] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._scribe, name="scribe", daemon=True)
        self._controller: Controller | None = None
        self._number = 0
        #: The cycles that are still to be sent: their times, and how far the messages before them go.
        self._cycles: list[tuple[list[Taped], CycleReport, int, int]] = []
        self._lost = 0
        self._warned = -_SILENCE
        self._state: object = None
        self._mode: Mode | None = None
        self._fault: Fault | None = None
        self._live: LivePart
        self._stamp: Callable[[], int] = time.time_ns
        self._trigger: bytes | None = None
        self._snapshot_due = 0
        self._yaml: list[tuple[Settings, str]] = []  # of the start, and the newest

    def tap(self, transport: Transport, stamp: Callable[[], int]) -> Transport:
        """A transport that records what passes through it.

        Args:
            transport: carries the messages.
            stamp: gives the time of messages, ns.
        """
        self._stamp = stamp
        return RecordingTransport(transport, self.channel, self.came, self.went, all_of_it=self._all_of_it)

    def attach(self, controller: Controller, node: str, robot: str) -> None:
        """Begin to record a controller, when every topic has been opened.

        Args:
            controller: of the loop.
            node: its fully qualified name.
            robot: the robot's name.
        """
        self._controller = controller
        config = controller.config
        rests = {name: task.rest(controller.dynamics) for name, task in controller.tasks.items()}
        slots, wanted = layout_of(controller.qp), references_of(controller.qp, rests)
        self._row = Row(controller.qp, slots)
        self._every = max(1, round(_SNAPSHOT / controller.period))
        self._references = ReferencesRow(self._every)
        spans = []
        for group, begin, end in groups(slots):
            channel = self.channel(f"{node}/{OWN}/{group}", "std_msgs/msg/Float64MultiArray")
            before = _before([slot for slot in slots if slot.group == group])
            spans.append((channel, before.hex(), 8 * begin, 8 * end))
        self._wanted = self.channel(f"{node}/{OWN}/references", "std_msgs/msg/Float64MultiArray")
        self._before_wanted = _before(wanted)
        self._events = self.channel(f"{node}/{OWN}/events", "std_msgs/msg/String")
        self._memories = self.channel(f"{node}/{OWN}/memory", "std_msgs/msg/String")
        start = self.channel(f"{node}/{OWN}/start", "std_msgs/msg/String")
        description = self.channel(f"{node}/{OWN}/robot_description", "std_msgs/msg/String")
        self._process.send(frame(TOPICS, 0, json.dumps({"topics": self._topics, "groups": spans}).encode()))
        urdf = config.urdf if config.urdf is not None else read_urdf(self._settings.robot.urdf)
        about = {
            "format": FORMAT,
            "robot": robot,
            "node": node,
            "software": software(),
            "config": config.to_yaml(),
            "layout": dumped((*slots, *wanted)),
            "modes": [mode.value for mode in MODES],
        }
        at = self._stamp()
        for channel, text in ((start, json.dumps(about)), (description, urdf)):
            self._process.send(frame(PINNED, at, struct.pack("<H", channel) + _string(text)))
        controller.tape = []
        self._live = controller.live.newest
        self._yaml = [(self._live.settings, "")]
        self._thread.start()
        self._remember(controller)

    def channel(self, topic: str, kind: str) -> int:
        """The number of a topic."""
        definition, _ = TYPES.generate_msgdef(kind, ros_version=2)
        self._topics.append([len(self._topics) + 1, topic, kind, definition])
        return len(self._topics)

    def came(self, channel: int, payload: bytes) -> None:
        """Record an incoming message, at this moment; from any thread."""
        size, messages, taken = len(payload), self._messages, self._taken.get(channel, 0)
        if size > _LARGEST or self._waiting >= _WAITING or len(messages) >= _MOST:  # where the loop does not run
            return
        if taken and taken + size > _SHARE:
            self._left_out[channel] += 1
            return
        self._taken[channel] = taken + size
        self._waiting += size
        messages += (FRAME.pack(size, channel, self._stamp()), payload)

    def went(self, channel: int, payload: bytes) -> None:
        """Record an outgoing message, at the time of its cycle."""
        messages = self._messages
        if len(messages) < _MOST:
            messages += (FRAME.pack(len(payload), channel, WITH_THE_CYCLE), payload)

    def status(self) -> dict[str, str]:
        """What became of the recordings, for `/diagnostics`: the last sentence, and how many there were."""
        count, sentence = self._process.said
        if self._process.dead:
            sentence = "the recorder has ended: nothing is recorded any more"
        elif self._lost:
            sentence = f"the recorder does not keep up: {self._lost} cycles lack"
        return {"recorder": sentence or self._kept, "recorder_said": str(count)}

    def request(self, reason: str = "REQUEST") -> None:
        """Have the last seconds written; from any thread."""
        self._trigger = frame(TRIGGER, 0, reason.encode())

    def observe(self, report: CycleReport) -> None:
        """Record the cycles since the last call: an observer of the loop, when the torques are out."""
        try:
            self._observe(report)
        except Exception:  # a defect of the recorder must not end the run
            _log.exception("the recorder has failed: nothing is recorded any more")
            if self._controller is not None:
                self._controller.tape = None

    def _observe(self, report: CycleReport) -> None:
        controller = self._controller
        if controller is None or controller.tape is None:
            return
        if controller.tape:
            self._cycles.append((controller.tape, report, self._stamp(), len(self._messages)))
            controller.tape = []
        if len(self._cycles) >= _TOGETHER or self._trigger is not None:
            self._send()
        if self._number >= self._snapshot_due:
            self._send()
            self._remember(controller)

    def _send(self) -> None:
        """Send the cycles since the last call, the messages that came and went, and what the thread has made."""
        batch: list[bytes] = []
        cycles, self._cycles = self._cycles, []
        messages, begin = self._messages, 0
        number = self._number
        for tape, report, at, end in cycles:
            batch += messages[begin:end]
            begin = end
            for taped in tape:
                self._cycle(taped, report if taped is tape[-1] else None, at, batch)
        end = len(messages)  # other threads add to them, behind
        batch += messages[begin:end]
        del messages[:end]
        self._waiting = 0
        self._taken = {}
        while self._done:
            batch.append(self._done.popleft())
        trigger, self._trigger = self._trigger, None
        if trigger is not None:
            batch.append(trigger)
        if not self._process.send(b"".join(batch)):
            self._lose(self._number - number)
            if not self._process.dead:  # a trigger is repeated until there is room in the pipe
                self._trigger = self._trigger or trigger
        elif self._lost:
            self._lost, self._snapshot_due = 0, self._number

    def _cycle(self, taped: Taped, report: CycleReport | None, at: int, batch: list[bytes]) -> None:
        """Add the frames of one cycle; only the last of a loop's cycle has its report."""
        same, self._state = taped.state is not None and taped.state is self._state, taped.state
        row = self._row.write(self._number, taped, report, same, self._rare(taped, report, at))
        batch += (FRAME.pack(len(row), CYCLE, at), row)
        references = taped.result.references
        wanted = self._references.write(self._number, references) if references is not None else None
        if wanted is not None:
            batch.append(frame(self._wanted, at, self._before_wanted + wanted))
        self._number += 1

    def _lose(self, cycles: int) -> None:
        """A gap: the replay goes on from the next snapshot."""
        self._lost += cycles
        now = time.monotonic()
        if now - self._warned >= _SILENCE:
            self._warned = now
            _log.warning("the recorder does not keep up: %d cycles lack in the recording", self._lost)

    def _rare(self, taped: Taped, report: CycleReport | None, at: int) -> bool:
        """Hand over what only some cycles have; whether this one has it."""
        result = taped.result
        refused = result.refused if report is None else report.refused
        same = result.mode is self._mode and result.fault is self._fault and taped.live is self._live
        left_out = self._left_out
        if same and not (taped.apart or taped.requests or taped.changes or refused or taped.problem or left_out):
            return False
        self._left_out = Counter()
        event: dict[str, Any] = {"cycle": self._number, "mode": result.mode.value}
        if result.fault is not None and (self._fault is None or self._fault.code != result.fault.code):
            self._trigger = frame(TRIGGER, 0, result.fault.code.encode())
        if result.fault is not self._fault:
            event["fault"] = result.fault
        if taped.live is not self._live:
            event["settings"] = taped.live.settings
        if taped.apart:
            event["apart"] = True
            self._snapshot_due = 0
        if taped.problem is not None:
            event["problem"] = taped.problem
        if taped.requests:
            event["requests"] = taped.requests
        if taped.changes:
            event["changes"] = taped.changes
        if refused:
            event["refused"] = refused
        if left_out:
            event["left out"] = {self._topics[channel - 1][1]: count for channel, count in left_out.items()}
        self._mode, self._fault, self._live = result.mode, result.fault, taped.live
        self._jobs.put(lambda: frame(self._events, at, _string(to_json(self._with_yaml(event)))))
        return True

    def _remember(self, controller: Controller) -> None:
        """Record all that the controller remembers, before the next cycle."""
        self._snapshot_due = self._number + self._every
        content = {
            "cycle": self._number,
            "settings": self._live.settings,
            "memory": controller.memory(),
        }
        at = self._stamp()
        self._jobs.put(lambda: frame(self._memories, at, _string(to_json(self._with_yaml(content)))))

    def _with_yaml(self, content: Mapping[str, Any]) -> dict[str, Any]:
        """The same with settings as YAML: empty where they are those of the start."""
        settings = content.get("settings")
        if settings is None:
            return dict(content)
        known = next((text for each, text in self._yaml if each is settings), None)
        if known is None:
            known = Config(settings, "").to_yaml()
            self._yaml = [self._yaml[0], (settings, known)]
        return {**content, "settings": known}

    def _scribe(self) -> None:
        while (job := self._jobs.get()) is not None:
            try:
                self._done.append(job())
            except Exception:  # a defect of the recorder must not end the run
                _log.exception("a part of the recording could not be made")

    def close(self) -> None:
        """Write all that is left, and end."""
        if self._thread.is_alive():
            self._jobs.put(None)
            self._thread.join()
            self._send()
        self._process.close()
        if self._controller is not None:
            self._controller.tape = None


def start_recorder(
    settings: Settings, file: Path | None = None, *, patient: bool = False, name: str = ""
) -> Recorder | None:
    """Start a recorder, as `Recorder` takes it; None where nothing is to be recorded, or can be, which is logged."""
    if file is None and not settings.recorder.seconds > 0.0:
        return None
    try:
        return Recorder(settings, file, patient=patient, name=name)
    except OSError as error:  # there is no room for another process
        _log.warning("nothing is recorded: the recorder cannot be started: %s", error.strerror or error)
        return None


@contextlib.contextmanager
def recording(settings: Settings, file: Path | None, *, name: str = "") -> Iterator[Recorder | None]:
    """A recorder for a run, as `start_recorder` gives it."""
    recorder = start_recorder(settings, file, name=name)
    try:
        yield recorder
    finally:
        if recorder is not None:
            recorder.close()


def _before(slots: Sequence[Slot]) -> bytes:
    """What stands before the numbers in a serialized array of these slots."""
    labels = [message("std_msgs/msg/MultiArrayDimension", label=s.name, size=s.size, stride=s.size) for s in slots]
    layout = message("std_msgs/msg/MultiArrayLayout", dim=labels, data_offset=0)
    count = sum(slot.size for slot in slots)
    whole = encode(message("std_msgs/msg/Float64MultiArray", layout=layout, data=np.zeros(count)))
    return whole[: len(whole) - 8 * count]


def _string(text: str) -> bytes:
    return encode(message("std_msgs/msg/String", data=text))
