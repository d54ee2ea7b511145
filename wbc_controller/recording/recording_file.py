"""A recording that is read: its configuration, its cycles, and the events of some cycles."""

from __future__ import annotations

import bisect
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wbc_controller.errors import ConfigurationError, InputRefused
from wbc_controller.middleware.codec import decode
from wbc_controller.recording.cycle_layout import FORMAT, Slot, split
from wbc_controller.recording.json_records import from_json
from wbc_controller.recording.mcap_file import McapMessages, Topic
from wbc_controller.recording.recorder import OWN
from wbc_controller.records import Array, Fault
from wbc_controller.settings.config import Config
from wbc_controller.settings.files import parse_settings

_STRING = "std_msgs/msg/String"


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
                    cycle = int(_numbers(payload, 1, self._cycle_size())[0])
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
                    self.events[int(event["cycle"])] = {**event, "time": time}
                elif kind == "memory":
                    self.memories[_cycle_of_memory(_text(payload))] = _text(payload)
        except OSError as error:
            raise ConfigurationError(f"recording {path}: cannot be read: {error.strerror or error}") from error
        except (ValueError, KeyError, IndexError, InputRefused) as error:
            raise ConfigurationError(f"recording {path}: {error}") from error
        self.damage, self.topics = file.damage, file.topics
        if not self.about or not urdf:
            raise ConfigurationError(
                f"recording {path}: not a recording of this controller: it has no topic …/{OWN}/start"
                + (f"; {self.damage}" if self.damage else "")
            )
        self.config = self.configured(self.about["config"], urdf)

    def _read_layout(self) -> None:
        if self.about["format"] != FORMAT:
            version = self.about.get("software", {}).get("wbc_controller", "unknown")
            raise ValueError(
                f"its format is {self.about['format']!r}; this version reads format {FORMAT}: read it with the version "
                f"of wbc_controller that wrote it ({version})"
            )
        self.slots = tuple(Slot(*each) for each in self.about["layout"])
        self._groups = {
            name: [s for s in self.slots if s.group == name] for name in dict.fromkeys(s.group for s in self.slots)
        }

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
        import yaml

        tree = next(iter(yaml.safe_load(text).values()))["ros__parameters"]
        source = f"the configuration in {self.path}"
        return Config(parse_settings(tree, source), source, self.config.urdf if urdf is None else urdf)

    def cycles(self, first: int = 0) -> Iterator[RecordedCycle]:
        """Read the cycles, from a number on."""
        groups = self._groups
        sizes = {name: sum(slot.size for slot in slots) for name, slots in groups.items()}
        *_, end = [name for name in groups if name != "references"]
        found: dict[str, Array] = {}
        references: Mapping[str, Array] = {}
        waiting: RecordedCycle | None = None
        for topic, time, payload in self.messages():
            kind = _kind(topic)
            if kind not in groups:
                continue
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
            if kind == end and "number" in found and int(found["number"][0]) >= first:
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


def _cycle_of_memory(text: str) -> int:
    """Return the cycle of a memory without parsing all of it."""
    return int(text[text.index(":") + 1 : text.index(",")])


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
