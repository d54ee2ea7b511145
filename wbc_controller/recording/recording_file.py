"""Reader of recordings."""

import contextlib
import heapq
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wbc_controller.errors import ConfigurationError, InputRefused
from wbc_controller.inverse_dynamics.references.changes import Change
from wbc_controller.middleware.codec import TYPES, decode
from wbc_controller.recording.cycle_layout import FORMAT, HEAD, MODES, Slot, slot_slices, split
from wbc_controller.recording.json_records import from_json, require_types
from wbc_controller.recording.mcap_file import McapMessages, Topic, write_messages
from wbc_controller.recording.recorder import OWN
from wbc_controller.records import Array, ChangeSettings, Fault
from wbc_controller.settings.config import Config
from wbc_controller.settings.files import parse_settings, read_parameters

_STRING = "std_msgs/msg/String"
_LARGEST_SLOT = 10_000  # numbers of a slot of the layout
#: Types of required and optional values of the topics ``start`` and ``events``.
_START = {
    "robot": str, "node": str, "software": Mapping[str, str], "config": str, "layout": list[list[str | int]],
}  # fmt: skip
_EVENT = {"cycle": int, "mode": str}
_PARTS_OF_EVENT = {
    "fault": Fault | None, "settings": str, "apart": bool, "problem": Fault | None, "requests": list[str],
    "changes": list[list[Change | ChangeSettings]], "refused": list[str], "left out": Mapping[str, int],
    "torques sent": list[float],
}  # fmt: skip
_BEGIN_OF_MEMORY = re.compile(r'\{"cycle":(\d{1,15}),')
#: Errors of inconsistent values, such as arrays of other sizes.
_MODIFIED = (ArithmeticError, AttributeError, LookupError, MemoryError, TypeError, ValueError)
#: Messages by name and type of the topic: stamp, ns, and serialized message, in order of the stamps.
AddedTopics = Mapping[tuple[str, str], Sequence[tuple[int, bytes]]]


@dataclass(frozen=True, slots=True)
class RecordedCycle:
    """Numbers of one cycle."""

    number: int  # since the start of the run
    time: int  # of the record, ns
    values: Mapping[str, Array]  # by slot of `cycle_layout`; NaN without a state, a command or a solution
    references: Mapping[str, Array]  # by slot of the references; empty before the first ones

    def scalar(self, name: str) -> float:
        """Return the value of a slot of size 1."""
        return float(self.values[name][0])

    @property
    def stamp(self) -> int:
        """Stamp of the state, ns; 0 without a state."""
        return int(self.scalar("stamp_seconds")) * 1_000_000_000 + int(self.scalar("stamp_nanoseconds"))


class Recording:
    """A recording. The attribute `config` is the configuration of the run with the URDF."""

    def __init__(self, path: Path) -> None:
        """Read everything except the cycles; another file or format raises `ConfigurationError`."""
        self.path = path
        self.events: dict[int, dict[str, Any]] = {}  # by cycle
        self.memories: dict[int, str] = {}  # memory before a cycle as JSON, by cycle
        self.about: dict[str, Any] = {}  # topic ``start``
        self.counts: dict[int, int] = {}  # messages by number of the topic
        self.first = self.last = -1  # cycles
        self.start = self.end = self.count = 0  # times of first and last cycle, ns; number of cycles
        file, urdf = McapMessages(path), ""
        try:
            for topic, time, payload in file:
                self.counts[topic.number] = self.counts.get(topic.number, 0) + 1
                kind = _kind(topic)
                if kind == "cycle":
                    if not self.about:
                        raise ValueError(f"the topic …/{OWN}/start is missing before the cycles")
                    size = sum(slot.size for slot in self._groups["cycle"])
                    cycle = _checked_head(_numbers(payload, len(HEAD), size))
                    if self.first < 0:
                        self.first, self.start = cycle, time
                    self.last, self.end, self.count = cycle, time, self.count + 1
                elif kind == "robot_description":
                    urdf = _text(payload)
                elif kind == "start":
                    self.about = from_json(_text(payload))
                    self._read_layout()
                elif kind == "events":
                    event = from_json(_text(payload))
                    require_types(event, _EVENT, "an event", _PARTS_OF_EVENT)
                    self.events[event["cycle"]] = {**event, "time": time}
                elif kind == "memory":
                    self.memories[_cycle_of_memory(_text(payload))] = _text(payload)
        except OSError as error:
            raise ConfigurationError(f"recording {path}: cannot be read: {error.strerror or error}") from error
        except (ValueError, InputRefused) as error:
            raise ConfigurationError(f"recording {path}: {error}") from error
        self.damage, self.topics = file.damage, file.topics
        if not self.about or not urdf:
            missing = f"no topic …/{OWN}/start" + (f"; {self.damage}" if self.damage else "")
            raise ConfigurationError(f"recording {path}: not a recording of this controller: {missing}")
        self.config = self.parse_configuration(self.about["config"], urdf)

    def _read_layout(self) -> None:
        require_types(self.about, {"format": int}, "its start", {"software": Mapping[str, str]})
        if self.about["format"] != FORMAT:
            version = self.about.get("software", {}).get("wbc_controller", "unknown")
            raise ValueError(
                f"format {self.about['format']!r}; this version reads format {FORMAT}: use the version of "
                f"wbc_controller that wrote the file ({version})"
            )
        require_types(self.about, _START, "its start")
        for each in self.about["layout"]:
            if not (list(map(type, each)) == [str, str, int] and 0 <= each[2] <= _LARGEST_SLOT):
                raise ValueError(
                    f"invalid slot {each!r} in the layout; valid: group, name, and a size up to {_LARGEST_SLOT}"
                )
        self.slots = tuple(Slot(*each) for each in self.about["layout"])
        if self.slots[: len(HEAD)] != tuple(Slot("cycle", name, 1) for name in HEAD):
            raise ValueError(f"the layout must begin with {', '.join(HEAD)}")
        groups = dict.fromkeys(slot.group for slot in self.slots)
        self._groups = {name: [slot for slot in self.slots if slot.group == name] for name in groups}

    def require_slots(self, slots: Sequence[Slot]) -> None:
        """Check a controller's slots; a missing slot or another size raises `ConfigurationError`."""
        recorded = {(slot.group, slot.name): slot.size for slot in self.slots}
        for slot in slots:
            size = recorded.get((slot.group, slot.name))
            if size != slot.size:
                raise ConfigurationError(
                    f"recording {self.path}: the layout has "
                    f"{'no' if size is None else size} numbers of {slot.group}/{slot.name}; the robot of the "
                    f"configuration has {slot.size}"
                )

    @contextlib.contextmanager
    def translated_errors(self, attempt: str) -> Iterator[None]:
        """Translate errors of inconsistent values into `ConfigurationError`."""
        try:
            yield
        except _MODIFIED as error:
            raise ConfigurationError(
                f"recording {self.path}: {attempt}: {type(error).__name__}: {error}; the file was modified, or a user "
                "class is missing"
            ) from error

    def elapsed(self, time: int) -> float:
        """Return the time from the start of the recording to a time in ns, s."""
        return 1.0e-9 * (time - self.start)

    def messages(self) -> Iterator[tuple[Topic, int, bytes]]:
        """Iterate over topic, time of arrival in ns, and serialized message."""
        return iter(McapMessages(self.path))

    def parse_configuration(self, text: str, urdf: str | None = None) -> Config:
        """Parse a configuration of the recording (empty: that of the start)."""
        if not text:
            return self.config
        source = f"the configuration in {self.path}"
        tree = read_parameters(text, source)
        return Config(parse_settings(tree, source), source, self.config.urdf if urdf is None else urdf)

    def cycles(self) -> Iterator[RecordedCycle]:
        """Yield the complete cycles."""
        slots = [slot for slot in self.slots if slot.group != "references"]
        for time, row, references in self._rows(self.messages()):
            values = split(slots, row)
            named = split(self._groups["references"], references) if len(references) else {}
            yield RecordedCycle(int(values["number"][0]), time, values, named)

    def _rows(self, messages: Iterable[tuple[Topic, int, bytes]]) -> Iterator[tuple[int, Array, Array]]:
        """Yield time, ns, numbers, and references (empty before the first ones) of the complete cycles."""
        sizes = {name: sum(slot.size for slot in slots) for name, slots in self._groups.items()}
        parts = [name for name in sizes if name != "references"]
        found: dict[str, Array] = {}
        references = np.zeros(0)
        waiting: tuple[int, Array] | None = None
        for topic, time, payload in messages:
            kind = _kind(topic)
            if kind not in sizes:
                continue
            with self.translated_errors(f"topic {topic.name}"):
                numbers = _numbers(payload, sizes[kind], sizes[kind])
            if waiting is not None and (kind == "cycle" or (kind == "references" and numbers[0] != waiting[1][0])):
                yield *waiting, references
                waiting = None
            if kind == "references":
                references = numbers
                continue
            if kind == "cycle":
                found = {}
            found[kind] = numbers
            if kind == parts[-1] and len(found) == len(parts):
                waiting = time, np.concatenate([found[name] for name in parts])
        if waiting is not None:
            yield *waiting, references

    def arrays(self, messages: Iterable[tuple[Topic, int, bytes]] | None = None) -> dict[str, Array]:
        """Return the cycles with a sent command as arrays by slot, with the references.

        Numbers are (n,), vectors (n, k), absent values NaN; ``stamp`` and ``time`` are in ns, ``mode`` contains names.
        Empty without commands. `messages` are those of the file, after other readers.
        """
        rows, times = [], []
        absent = np.full(sum(slot.size for slot in self.slots if slot.group == "references"), np.nan)
        places = {slot.name: place.start for slot, place in slot_slices(self.slots)}
        for time, row, references in self._rows(messages or self.messages()):
            if row[places["has_command"]] and not np.isnan(row[places["seconds/total"]]):  # sent
                rows.append(np.concatenate([row, references if len(references) else absent]))
                times.append(time)
        if not rows:
            return {}
        table = np.array(rows)
        arrays: dict[str, Array] = {}
        for slot, place in slot_slices(self.slots):
            single = slot.size == 1 and (slot.group == "cycle" or slot.name.startswith(("weight/", "contact/")))
            if slot.name not in arrays:  # `references` repeats ``number``
                arrays[slot.name] = table[:, place.start] if single else table[:, place]
        return {
            **arrays,
            "number": arrays["number"].astype(np.int64),
            "stamp": 10**9 * arrays["stamp_seconds"].astype(np.int64) + arrays["stamp_nanoseconds"].astype(np.int64),
            "time": np.array(times),
            "mode": np.array([MODES[int(mode)].value for mode in arrays["mode"]]),
        }

    def memory_after(self, cycle: int) -> int | None:
        """Return the first recorded memory from a cycle on, or None."""
        return min((each for each in self.memories if each >= cycle), default=None)

    @property
    def faults(self) -> dict[int, Fault]:
        """Faults with their final sentences, by the cycle with the detection."""
        found: dict[int, Fault] = {}
        before, detected = None, 0
        for cycle in sorted(self.events):
            fault = self.events[cycle].get("fault", before)
            if fault is not None:
                if before is None or fault.code != before.code:
                    detected = cycle
                found[detected] = fault  # with its explanation
            before = fault
        return found


def add_topics(path: Path, added: AddedTopics) -> None:
    """Add topics in place, each message at the cycle with its stamp.

    Raises `ConfigurationError` if the file is not a recording, and `OSError` if it cannot be written.
    """
    recording = Recording(path)
    stamps, times = np.array([(cycle.stamp, cycle.time) for cycle in recording.cycles()], dtype=np.float64).T
    number = max(recording.topics)
    topics, messages = list(recording.topics.values()), []
    for (name, kind), content in added.items():
        number += 1
        topics.append(Topic(number, name, kind, TYPES.generate_msgdef(kind, ros_version=2)[0]))
        messages.append([(number, round(float(np.interp(stamp, stamps, times))), data) for stamp, data in content])
    recorded = ((topic.number, time, data) for topic, time, data in McapMessages(path))
    draft = path.with_suffix(".part")
    draft.unlink(missing_ok=True)  # do not follow a link
    write_messages(draft, topics, heapq.merge(recorded, *messages, key=lambda message: message[1]))
    draft.replace(path)


def _checked_head(head: Array) -> int:
    numbers = dict(zip(HEAD, head.tolist(), strict=True))
    largest = {"number": 2**53, "stamp_seconds": 2**32, "stamp_nanoseconds": 10**9, "mode": len(MODES) - 1}
    for name, limit in largest.items():
        if not (0 <= numbers[name] <= limit):
            raise ValueError(f"a cycle has {name} = {numbers[name]:g}; valid: 0 to {limit}")
    if not np.isfinite(head).all():
        raise ValueError(f"a cycle has a non-finite number: {numbers}")
    return int(numbers["number"])


def _cycle_of_memory(text: str) -> int:
    found = _BEGIN_OF_MEMORY.match(text)
    if found is None:
        raise ValueError(f"a memory must begin with its cycle, not with {text[:40]!r}")
    return int(found[1])


def _kind(topic: Topic) -> str:
    before, _, name = topic.name.rpartition("/")
    return name if before.endswith(f"/{OWN}") else ""


def _numbers(payload: bytes, count: int, size: int) -> Array:
    at = len(payload) - 8 * size
    if at < 0:
        raise ValueError("a cycle has fewer numbers than its layout")
    row: Array = np.frombuffer(payload, dtype="<f8", count=count, offset=at)
    return row


def _text(payload: bytes) -> str:
    return str(decode(payload, _STRING).data)
