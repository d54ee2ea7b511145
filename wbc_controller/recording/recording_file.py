"""A recording that is read: its configuration, its cycles, and the events of some cycles."""

from __future__ import annotations

import bisect
import contextlib
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wbc_controller.errors import ConfigurationError, InputRefused
from wbc_controller.inverse_dynamics.references.changes import Change
from wbc_controller.middleware.codec import decode
from wbc_controller.recording.cycle_layout import FORMAT, HEAD, MODES, Slot, split
from wbc_controller.recording.json_records import from_json, require_types
from wbc_controller.recording.mcap_file import McapMessages, Topic
from wbc_controller.recording.recorder import OWN
from wbc_controller.records import Array, ChangeSettings, Fault
from wbc_controller.settings.config import Config
from wbc_controller.settings.files import parse_settings, read_parameters

_STRING = "std_msgs/msg/String"
#: Most numbers of a slot of the layout.
_LARGEST_SLOT = 10_000
#: Types of the values of the topics ``start``, ``events`` and ``memory``, and of values that may be absent.
_START = {
    "robot": str, "node": str, "software": Mapping[str, str], "config": str, "layout": list[list[str | int]],
}  # fmt: skip
_EVENT = {"cycle": int, "mode": str}
_PARTS_OF_EVENT = {
    "fault": Fault | None, "settings": str, "apart": bool, "problem": Fault | None, "requests": list[str],
    "changes": list[list[Change | ChangeSettings]], "refused": list[str], "left out": Mapping[str, int],
}  # fmt: skip
_BEGIN_OF_MEMORY = re.compile(r'\{"cycle":(\d{1,15}),')
_MEMORY = {"cycle": int, "settings": str, "memory": Mapping[str, Any]}
#: Errors of values of the right type that do not fit together, such as arrays of other sizes.
_MODIFIED = (ArithmeticError, AttributeError, LookupError, MemoryError, TypeError, ValueError)


@dataclass(frozen=True, slots=True)
class RecordedCycle:
    """The numbers of one cycle."""

    number: int  # number of the cycle since the start of the run
    time: int  # time of the record, ns
    values: Mapping[str, Array]  # arrays by slot of `cycle_layout`; NaN without a state, a command or a solution
    references: Mapping[str, Array]  # arrays by slot of the references in force; empty before the first references

    def number_of(self, name: str) -> float:
        """Return the value of a slot of size 1."""
        return float(self.values[name][0])

    @property
    def stamp(self) -> int:
        """Stamp of the state, ns; 0 without a state."""
        return int(self.number_of("stamp_seconds")) * 1_000_000_000 + int(self.number_of("stamp_nanoseconds"))


@dataclass(frozen=True, slots=True)
class RecordedFault:
    """A fault of a recording."""

    cycle: int  # number of the cycle that found it
    time: int  # time of that cycle, ns
    fault: Fault  # the fault with its final sentence


class Recording:
    """A recording.

    Attributes:
        about: contents of the topic ``start``: ``robot``, ``node``, ``software``, ``layout``, …
        config: configuration of the run, with the URDF.
        events: events by number of their cycle.
        memories: memory of the controller before a cycle, by number of the cycle, as JSON.
        start: time of the first cycle, ns.
        end: time of the last cycle, ns.
        topics: topics of the file, by number.
        counts: number of messages by number of the topic.
        damage: why the reading ended early; empty if the file is complete.
    """

    def __init__(self, path: Path) -> None:
        """Read everything except the cycles.

        Raises:
            ConfigurationError: if the file cannot be read, is not a recording of a controller, or has another format.
        """
        self.path = path
        self.events: dict[int, dict[str, Any]] = {}
        self.memories: dict[int, str] = {}
        self.about: dict[str, Any] = {}
        self.counts: dict[int, int] = {}
        self.first = self.last = -1
        self.start = self.end = self.count = 0
        file, urdf = McapMessages(path), ""
        try:
            for topic, time, payload in file:
                self.counts[topic.number] = self.counts.get(topic.number, 0) + 1
                kind = _kind(topic)
                if kind == "cycle":
                    if not self.about:
                        raise ValueError(f"its cycles have no topic …/{OWN}/start before them")
                    cycle = _checked_head(_numbers(payload, len(HEAD), self._cycle_size()))
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
            raise ConfigurationError(
                f"recording {path}: not a recording of this controller: it has no topic …/{OWN}/start"
                + (f"; {self.damage}" if self.damage else "")
            )
        self.config = self.configured(self.about["config"], urdf)

    def _read_layout(self) -> None:
        require_types(self.about, {"format": int}, "its start", {"software": Mapping[str, str]})
        if self.about["format"] != FORMAT:
            version = self.about.get("software", {}).get("wbc_controller", "unknown")
            raise ValueError(
                f"its format is {self.about['format']!r}; this version reads format {FORMAT}: read it with the version "
                f"of wbc_controller that wrote it ({version})"
            )
        require_types(self.about, _START, "its start")
        for each in self.about["layout"]:
            if not (list(map(type, each)) == [str, str, int] and 0 <= each[2] <= _LARGEST_SLOT):
                raise ValueError(
                    f"its layout has the slot {each!r}; valid: group, name, and a size up to {_LARGEST_SLOT}"
                )
        self.slots = tuple(Slot(*each) for each in self.about["layout"])
        if self.slots[: len(HEAD)] != tuple(Slot("cycle", name, 1) for name in HEAD):
            raise ValueError(f"its layout does not begin with {', '.join(HEAD)}")
        self._groups = {
            name: [s for s in self.slots if s.group == name] for name in dict.fromkeys(s.group for s in self.slots)
        }

    def require_slots(self, slots: Sequence[Slot]) -> None:
        """Check that the cycles have the numbers of a controller.

        Raises:
            ConfigurationError: if a slot is missing or has another size.
        """
        recorded = {(slot.group, slot.name): slot.size for slot in self.slots}
        for slot in slots:
            size = recorded.get((slot.group, slot.name))
            if size != slot.size:
                raise ConfigurationError(
                    f"recording {self.path}: its layout has "
                    f"{'no' if size is None else size} numbers of {slot.group}/{slot.name}; the robot of its "
                    f"configuration has {slot.size}"
                )

    @contextlib.contextmanager
    def translated_errors(self, attempt: str) -> Iterator[None]:
        """Translate errors of a recorded memory whose values do not fit the controller.

        Raises:
            ConfigurationError: with the attempt, such as ``the memory before cycle 5``.
        """
        try:
            yield
        except _MODIFIED as error:
            raise ConfigurationError(
                f"recording {self.path}: {attempt}: {type(error).__name__}: {error}; the file was modified, or a class "
                "of the user is missing"
            ) from error

    def memory_of(self, cycle: int) -> dict[str, Any]:
        """Return the recorded memory before a cycle: ``settings``, ``memory``.

        Raises:
            ConfigurationError: if it is not the memory of a controller.
        """
        with self.translated_errors(f"the memory before cycle {cycle}"):
            content = from_json(self.memories[cycle])
            require_types(content, _MEMORY, "it")
        return dict(content)

    def _cycle_size(self) -> int:
        return sum(slot.size for slot in self._groups["cycle"])

    def messages(self) -> Iterator[tuple[Topic, int, bytes]]:
        """Read all messages: topic, time of arrival in ns, and serialized message."""
        return iter(McapMessages(self.path))

    def configured(self, text: str, urdf: str | None = None) -> Config:
        """Parse a configuration of the recording; an empty text means the one of the start.

        Raises:
            ConfigurationError: if this version refuses it.
        """
        if not text:
            return self.config
        source = f"the configuration in {self.path}"
        tree = read_parameters(text, source)
        return Config(parse_settings(tree, source), source, self.config.urdf if urdf is None else urdf)

    def cycles(self, first: int = 0) -> Iterator[RecordedCycle]:
        """Read the cycles, from a number on."""
        groups = self._groups
        sizes = {name: sum(slot.size for slot in slots) for name, slots in groups.items()}
        *_, end = [name for name in groups if name != "references"]
        complete = sum(len(slots) for name, slots in groups.items() if name != "references")
        found: dict[str, Array] = {}
        references: Mapping[str, Array] = {}
        waiting: RecordedCycle | None = None
        for topic, time, payload in self.messages():
            kind = _kind(topic)
            if kind not in groups:
                continue
            with self.translated_errors(f"topic {topic.name}"):
                row = _numbers(payload, sizes[kind], sizes[kind])
            if kind == "references":
                references = split(groups[kind], row)
                if waiting is not None and int(references["number"][0]) == waiting.number:
                    waiting = RecordedCycle(waiting.number, waiting.time, waiting.values, references)
                continue
            if kind == "cycle":
                if waiting is not None:
                    yield waiting
                    waiting = None
                found = {}
            found |= split(groups[kind], row)
            if kind == end and len(found) == complete and int(found["number"][0]) >= first:
                waiting = RecordedCycle(int(found["number"][0]), time, found, references)
        if waiting is not None:
            yield waiting

    def memory_before(self, cycle: int) -> int | None:
        """Return the last cycle up to the given one whose memory is recorded, or None."""
        known = sorted(self.memories)
        place = bisect.bisect_right(known, cycle)
        return known[place - 1] if place else None

    def memory_after(self, cycle: int) -> int | None:
        """Return the first cycle from the given one on whose memory is recorded, or None."""
        return next((each for each in sorted(self.memories) if each >= cycle), None)

    @property
    def faults(self) -> list[RecordedFault]:
        """All faults in order, each once."""
        found: list[RecordedFault] = []
        before: Fault | None = None
        for cycle in sorted(self.events):
            event = self.events[cycle]
            if "fault" not in event:
                continue
            fault = event["fault"]
            if fault is not None and before is not None and fault.code == before.code:
                found[-1] = RecordedFault(found[-1].cycle, found[-1].time, fault)  # now it is explained
            elif fault is not None:
                found.append(RecordedFault(cycle, event["time"], fault))
            before = fault
        return found

    def message_counts(self) -> Sequence[tuple[str, str, int]]:
        """Return name, type and number of messages of each topic with messages."""
        return [(topic.name, topic.type, self.counts[number]) for number, topic in self.topics.items()
                if number in self.counts]  # fmt: skip


def _checked_head(head: Array) -> int:
    """Return the number of a cycle from its first numbers, `HEAD`.

    Raises:
        ValueError: if a number is out of its range.
    """
    numbers = dict(zip(HEAD, head.tolist(), strict=True))
    largest = {"number": 2**53, "stamp_seconds": 2**32, "stamp_nanoseconds": 10**9, "mode": len(MODES) - 1}
    for name, limit in largest.items():
        if not (0 <= numbers[name] <= limit):
            raise ValueError(f"a cycle has {name} = {numbers[name]:g}; valid: 0 to {limit}")
    if not np.isfinite(head).all():
        raise ValueError(f"a cycle has a number that is not finite: {numbers}")
    return int(numbers["number"])


def _cycle_of_memory(text: str) -> int:
    """Return the cycle of a memory without parsing all of it.

    Raises:
        ValueError: if the text does not begin with the cycle.
    """
    found = _BEGIN_OF_MEMORY.match(text)
    if found is None:
        raise ValueError(f"a memory begins with {text[:40]!r}, not with its cycle")
    return int(found[1])


def _kind(topic: Topic) -> str:
    """Return the name of one of the recorder's own topics, and an empty text for any other topic."""
    before, _, name = topic.name.rpartition("/")
    return name if before.endswith(f"/{OWN}") else ""


def _numbers(payload: bytes, count: int, size: int) -> Array:
    """Return the first `count` numbers of a serialized array of `size` doubles."""
    at = len(payload) - 8 * size
    if at < 0:
        raise ValueError("a cycle has fewer numbers than its layout")
    row: Array = np.frombuffer(payload, dtype="<f8", count=count, offset=at)
    return row


def _text(payload: bytes) -> str:
    return str(decode(payload, _STRING).data)
