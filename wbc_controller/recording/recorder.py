"""The flight recorder, with a writer process.

The loop's thread sends numbers and messages in batches through a pipe. A separate thread converts rare events and the
controller's memory (every two seconds) to JSON.
"""

import contextlib
import importlib.metadata
import json
import logging
import os
import platform
import queue
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

import wbc_controller
from wbc_controller.controller.build.robot_description import read_urdf
from wbc_controller.controller.controller import Controller
from wbc_controller.controller.live_settings import LivePart
from wbc_controller.controller.memory import CycleRecord
from wbc_controller.controller.report import CycleReport
from wbc_controller.middleware.codec import TYPES, encode, message
from wbc_controller.middleware.topics import Endpoint
from wbc_controller.middleware.transports.transport import Publish, Transport, TransportWrapper
from wbc_controller.recording import cycle_layout as layout
from wbc_controller.recording.json_records import to_json
from wbc_controller.recording.writer import PINNED, TOPICS, TRIGGER, frame
from wbc_controller.recording.writer_process import WriterProcess
from wbc_controller.records import Fault, Mode
from wbc_controller.settings import Settings
from wbc_controller.settings.config import Config

_log = logging.getLogger(__name__)

_SNAPSHOT = 2.0  # period of the controller's memory, the starting points of a replay, s
_BATCH = 8  # cycles, for half the cost of each
_MAX_WAITING_BYTES, _MAX_MESSAGES = 8 << 20, 10_000  # waiting for the end of a cycle
_MAX_TOPIC_BYTES = 64 << 10  # of several messages per topic and batch: floods must not displace cycles
_MAX_MESSAGE_BYTES = 1 << 20  # the controller rejects larger messages with an event
_WARNING_PERIOD = 10.0  # s
NOT_RECORDED = "nothing is recorded: recorder.seconds is 0"
OWN = "recording"  # namespace of the recorder's topics
#: Packages that affect the last bits of torques.
_SOFTWARE = (
    "numba", "llvmlite", "numpy", "scipy", "pin", "daqp", "osqp", "proxsuite", "qpsolvers", "coal",
)  # fmt: skip
_ARRAY, _STRING = "std_msgs/msg/Float64MultiArray", "std_msgs/msg/String"


def recording_folder(settings: Settings) -> Path:
    """Return the folder of fault recordings."""
    if settings.recorder.folder:
        return Path(settings.recorder.folder).expanduser()
    state = os.environ.get("XDG_STATE_HOME") or str(Path("~/.local/state").expanduser())
    return Path(state) / "wbc_controller"


def software_versions() -> dict[str, str]:
    """Return all versions that affect torques."""
    versions = {
        "wbc_controller": wbc_controller.__version__,
        "python": platform.python_version(),
        "machine": platform.machine(),
    }
    for name in _SOFTWARE:
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            versions[name] = importlib.metadata.version(name)
    return versions


class Recorder:
    """Recorder of one loop: of the whole run in a file, or of the last seconds.

    A `patient` recorder, for simulated time, waits for the process instead of dropping cycles.
    """

    def __init__(self, settings: Settings, file: Path | None = None, *, patient: bool = False, name: str = "") -> None:
        seconds = settings.recorder.seconds
        self.whole_run = file is not None  # record topics without other subscriptions too
        kept = f"the last {seconds:g} s are kept"
        self._mode_text = kept if file is None else f"all is recorded in {str(file)!r}"
        plan = {
            "file": str(file) if file is not None else None,
            "folder": str(recording_folder(settings)) if seconds > 0.0 else None,
            "seconds": seconds,
            "files": settings.recorder.files,
            "name": name or "robot",
        }
        self._process = WriterProcess(plan, patient=patient)
        self._settings = settings
        self._topics: list[list[Any]] = []
        #: Messages since the last batch: topic, stamp, ns (None: stamp of the cycle), serialized message.
        self._messages: list[tuple[int, int | None, bytes]] = []
        self._waiting_bytes = 0
        self._waiting_by_topic: dict[int, int] = {}  # by topic
        self._dropped: Counter[int] = Counter()  # messages by topic since the last event
        self._json_frames: deque[bytes] = deque()  # from the thread
        self._jobs: queue.SimpleQueue[Callable[[], bytes] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._write_json, name="scribe", daemon=True)
        self._controller: Controller | None = None
        self._number = 0
        #: Cycles since the last batch: records, report, time, and number of earlier messages.
        self._cycles: list[tuple[list[CycleRecord], CycleReport, int, int]] = []
        self._last = 0  # time of the last cycle, ns
        self._dropped_cycles = 0
        self._warned_at = -_WARNING_PERIOD
        self._state: object = None
        self._mode: Mode | None = None
        self._fault: Fault | None = None
        self._live: LivePart
        self.stamp: Callable[[], int] = time.time_ns  # time of a message, ns
        self._trigger: bytes | None = None
        self._snapshot_due = 0
        self._yaml: list[tuple[Settings, str]] = []  # of the start, and the newest

    def attach(self, controller: Controller, node: str, robot: str) -> None:
        """Begin the recording of a controller, after all topics were opened."""
        self._controller = controller
        config = controller.config
        slots = layout.cycle_slots(controller.model, controller.contacts)
        references = layout.reference_slots(controller.tasks, controller.contacts)
        self._row = layout.CycleRow(slots)
        self._every = max(1, round(_SNAPSHOT / controller.period))
        self._references = layout.ReferencesRow(self._every)
        topic = f"{node}/{OWN}"
        self._groups: list[tuple[int, bytes, slice]] = []  # topic, start of its message, place in the row
        for group, members in groupby(layout.slot_slices(slots), key=lambda pair: pair[0].group):
            content, places = zip(*members, strict=True)
            place = slice(places[0].start, places[-1].stop)
            self._groups.append((self.channel(f"{topic}/{group}", _ARRAY), _array_prefix(content), place))
        self._references_topic = self.channel(f"{topic}/references", _ARRAY)
        self._references_start = _array_prefix(references)
        self._events = self.channel(f"{topic}/events", _STRING)
        self._memories = self.channel(f"{topic}/memory", _STRING)
        about_topic, urdf_topic = (self.channel(f"{topic}/{name}", _STRING) for name in ("start", "robot_description"))
        self._process.send(frame(TOPICS, 0, json.dumps(self._topics).encode()))
        urdf = config.urdf if config.urdf is not None else read_urdf(self._settings.robot.urdf)
        about = {
            "format": layout.FORMAT,
            "robot": robot,
            "node": node,
            "software": software_versions(),
            "config": config.to_yaml(),
            "layout": [[slot.group, slot.name, slot.size] for slot in (*slots, *references)],
            "modes": [mode.value for mode in layout.MODES],
        }
        at = self.stamp()
        for number, text in ((about_topic, json.dumps(about)), (urdf_topic, urdf)):
            self._process.send(frame(PINNED, at, number.to_bytes(2, "little") + _string(text)))
        controller.cycle_records = []
        self._live = controller.live.newest
        self._yaml = [(self._live.settings, "")]
        self._thread.start()
        self._record_memory(controller)

    def channel(self, topic: str, kind: str) -> int:
        """Add a topic, and return its number."""
        definition, _ = TYPES.generate_msgdef(kind, ros_version=2)
        self._topics.append([len(self._topics) + 1, topic, kind, definition])
        return len(self._topics)

    def record_incoming(self, topic: int, payload: bytes) -> None:
        """Record an incoming message, from any thread."""
        size, taken = len(payload), self._waiting_by_topic.get(topic, 0)
        full = self._waiting_bytes >= _MAX_WAITING_BYTES or len(self._messages) >= _MAX_MESSAGES  # the loop is stopped
        if full or size > _MAX_MESSAGE_BYTES:
            return
        if taken and taken + size > _MAX_TOPIC_BYTES:
            self._dropped[topic] += 1
            return
        self._waiting_by_topic[topic] = taken + size
        self._waiting_bytes += size
        self._messages.append((topic, self.stamp(), payload))

    def record_outgoing(self, topic: int, payload: bytes) -> None:
        """Record an outgoing message at the time of its cycle."""
        if len(self._messages) < _MAX_MESSAGES:
            self._messages.append((topic, None, payload))

    def status(self) -> dict[str, str]:
        """Return the last message and their number, for `/diagnostics`."""
        count, sentence = self._process.last_message
        if self._process.dead:
            sentence = "the recorder has ended: nothing is recorded any more"
        elif self._dropped_cycles:
            sentence = f"the recorder is too slow: {self._dropped_cycles} cycles were dropped"
        return {"recorder": sentence or self._mode_text, "recorder_said": str(count)}

    def request(self, reason: str = "REQUEST") -> None:
        """Write the last seconds to a file, from any thread."""
        self._trigger = frame(TRIGGER, 0, reason.encode())

    def observe(self, report: CycleReport) -> None:
        """Record the cycles since the last call."""
        controller = self._controller
        if controller is None or controller.cycle_records is None:
            return
        try:
            if controller.cycle_records:
                self._cycles.append((controller.cycle_records, report, self.stamp(), len(self._messages)))
                controller.cycle_records = []
            if len(self._cycles) >= _BATCH or self._trigger is not None:
                self._send()
            if self._number >= self._snapshot_due:
                self._send()
                self._record_memory(controller)
        except Exception:  # must not end the run
            _log.exception("the recorder failed: nothing is recorded any more")
            controller.cycle_records = None

    def _send(self) -> None:
        batch: list[bytes] = []
        cycles, self._cycles = self._cycles, []
        begin, number = 0, self._number
        for cycle_records, report, at, end in cycles:
            self._add_messages(batch, begin, end, at)
            begin, self._last = end, at
            for record in cycle_records:
                self._add_cycle(batch, record, report if record is cycle_records[-1] else None, at)
        end = len(self._messages)  # other threads append more
        self._add_messages(batch, begin, end, self._last)
        del self._messages[:end]
        self._waiting_bytes = 0
        self._waiting_by_topic = {}
        while self._json_frames:
            batch.append(self._json_frames.popleft())
        trigger, self._trigger = self._trigger, None
        if trigger is not None:
            batch.append(trigger)
        if not self._process.send(b"".join(batch)):
            self._dropped_cycles += self._number - number
            now = time.monotonic()
            if now - self._warned_at >= _WARNING_PERIOD:
                self._warned_at = now
                _log.warning("the recorder is too slow: %d cycles were dropped", self._dropped_cycles)
            if not self._process.dead:  # repeat the trigger until the pipe has room
                self._trigger = self._trigger or trigger
        elif self._dropped_cycles:
            self._dropped_cycles, self._snapshot_due = 0, self._number

    def _add_messages(self, batch: list[bytes], begin: int, end: int, at: int) -> None:
        messages = self._messages[begin:end]
        batch += [frame(topic, at if stamp is None else stamp, payload) for topic, stamp, payload in messages]

    def _add_cycle(self, batch: list[bytes], record: CycleRecord, report: CycleReport | None, at: int) -> None:
        same, self._state = record.inputs.state is not None and record.inputs.state is self._state, record.inputs.state
        event = self._add_event(record, report, at)
        row = self._row.write(self._number, record, report, same=same, event=event)
        batch += [frame(topic, at, start + row[place].tobytes()) for topic, start, place in self._groups]
        references = record.result.references
        changed = self._references.write(self._number, references) if references is not None else None
        if changed is not None:
            batch.append(frame(self._references_topic, at, self._references_start + changed.tobytes()))
        self._number += 1

    def _add_event(self, record: CycleRecord, report: CycleReport | None, at: int) -> bool:
        result, inputs = record.result, record.inputs
        refused = result.refused if report is None else report.refused
        same = result.mode is self._mode and result.fault is self._fault and record.live is self._live
        dropped = self._dropped
        news = record.changed_outside or inputs.requests or inputs.changes or refused or inputs.problem or dropped
        if same and not news:
            return False
        self._dropped = Counter()
        event: dict[str, Any] = {"cycle": self._number, "mode": result.mode.value}
        if result.fault is not None and (self._fault is None or self._fault.code != result.fault.code):
            self._trigger = frame(TRIGGER, 0, result.fault.code.encode())
        if result.fault is not self._fault:
            event["fault"] = result.fault
        if record.live is not self._live:
            event["settings"] = record.live.settings
        if record.changed_outside:
            event["apart"] = True
            self._snapshot_due = 0
        parts = {
            "problem": inputs.problem,
            "requests": inputs.requests,
            "changes": inputs.changes,
            "refused": refused,
            "torques sent": None if inputs.torques_sent is None else inputs.torques_sent.tolist(),
            "left out": {self._topics[topic - 1][1]: count for topic, count in dropped.items()},
        }
        event |= {name: part for name, part in parts.items() if part}
        self._mode, self._fault, self._live = result.mode, result.fault, record.live
        self._jobs.put(lambda: frame(self._events, at, _string(to_json(self._with_yaml(event)))))
        return True

    def _record_memory(self, controller: Controller) -> None:
        self._snapshot_due = self._number + self._every
        content = {"cycle": self._number, "settings": self._live.settings, "memory": controller.memory()}
        at = self.stamp()
        self._jobs.put(lambda: frame(self._memories, at, _string(to_json(self._with_yaml(content)))))

    def _with_yaml(self, content: Mapping[str, Any]) -> dict[str, Any]:
        settings = content.get("settings")
        if settings is None:
            return dict(content)
        known = next((text for each, text in self._yaml if each is settings), None)
        if known is None:
            known = Config(settings, "").to_yaml()
            self._yaml = [self._yaml[0], (settings, known)]
        return {**content, "settings": known}

    def _write_json(self) -> None:
        while (job := self._jobs.get()) is not None:
            try:
                self._json_frames.append(job())
            except Exception:  # must not end the run
                _log.exception("an event or a memory could not be recorded")

    def close(self) -> None:
        """Write everything and end."""
        if self._thread.is_alive():
            self._send()  # passes the last events to the thread
            self._jobs.put(None)
            self._thread.join()
            self._send()
        self._process.close()
        if self._controller is not None:
            self._controller.cycle_records = None


class RecordingTransport(TransportWrapper):
    """Wrapper that records messages; outgoing ones after they were sent."""

    def __init__(self, transport: Transport, recorder: Recorder) -> None:
        super().__init__(transport)
        self._recorder = recorder

    def advertise(self, endpoint: Endpoint) -> Publish:
        """See `Transport`."""
        publish = self._transport.advertise(endpoint)
        record, topic = self._recorder.record_outgoing, self._recorder.channel(endpoint.name, endpoint.type)

        def send(payload: bytes) -> None:
            publish(payload)
            record(topic, payload)

        return send

    def _receiver(self, endpoint: Endpoint) -> Callable[[bytes], bool]:
        record, topic = self._recorder.record_incoming, self._recorder.channel(endpoint.name, endpoint.type)

        def receive(payload: bytes) -> bool:
            record(topic, payload)
            return True

        return receive

    def has_reader(self, endpoint: Endpoint) -> bool:
        """Return True with a subscription, or if the whole run is recorded."""
        return self._recorder.whole_run or self._transport.has_reader(endpoint)


@contextlib.contextmanager
def recording(settings: Settings, file: Path | None = None, *, name: str = "") -> Iterator[Recorder | None]:
    """Open a recorder for a run; None if it is off, or cannot be started (logged)."""
    recorder = None
    if file is not None or settings.recorder.seconds > 0.0:
        try:
            recorder = Recorder(settings, file, name=name)
        except OSError as error:  # too many processes
            _log.warning("nothing is recorded: the recorder cannot be started: %s", error.strerror or error)
    with contextlib.nullcontext() if recorder is None else contextlib.closing(recorder):
        yield recorder


def _array_prefix(slots: Sequence[layout.Slot]) -> bytes:
    labels = [message("std_msgs/msg/MultiArrayDimension", label=s.name, size=s.size, stride=s.size) for s in slots]
    count = sum(slot.size for slot in slots)
    whole = encode(message(_ARRAY, layout={"dim": labels}, data=np.zeros(count)))
    return whole[: len(whole) - 8 * count]


def _string(text: str) -> bytes:
    return encode(message(_STRING, data=text))
