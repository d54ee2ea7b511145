"""Recordings that are read: the cycles one after the other, and what only some of them have."""

from __future__ import annotations

import bisect
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wbc_controller.errors import ConfigurationError, InputRefused
from wbc_controller.middleware.codec import decode
from wbc_controller.recording.layout import FORMAT, Slot, split
from wbc_controller.recording.mcap import Channel, Contents, read
from wbc_controller.recording.plain import from_json
from wbc_controller.recording.recorder import OWN
from wbc_controller.records import Array, Fault
from wbc_controller.settings.config import Config
from wbc_controller.settings.files import parse_settings

_STRING = "std_msgs/msg/String"


@dataclass(frozen=True, slots=True)
class Cycle:
    """The numbers of one cycle.

    Attributes:
        number: of the cycle, counted from the start of the run.
        time: at which it was recorded, ns.
        values: by slot, as `layout` names them; those of an absent state, command or solution are NaN.
        references: likewise, those in force; empty before the first.
    """

    number: int
    time: int
    values: Mapping[str, Array]
    references: Mapping[str, Array]

    def number_of(self, name: str) -> float:
        """A slot with one number."""
        return float(self.values[name][0])


@dataclass(frozen=True, slots=True)
class NamedFault:
    """A fault of a recording.

    Attributes:
        cycle: in which it was found.
        time: of that cycle, ns.
        fault: with the last sentence that was said of it.
    """

    cycle: int
    time: int
    fault: Fault


class Recorded:
    """A recording.

    Attributes:
        path: of the file.
        about: what it says of itself at its start: ``robot``, ``node``, ``software``, ``layout``.
        config: the configuration of the run, with the URDF.
        events: what only some cycles have, by cycle.
        memories: what the controller remembered before a cycle, by cycle, as JSON.
        first: number of the first cycle.
        last: number of the last cycle.
        count: number of cycles.
        start: time of the first cycle, ns.
        end: time of the last cycle, ns.
        channels: the topics, by number.
        counts: number of messages of each topic.
        torn: why it was read up to some point alone; empty where it is whole.
    """

    def __init__(self, path: Path) -> None:
        """Read all but the cycles.

        Args:
            path: of the file.

        Raises:
            ConfigurationError: where it cannot be read, or is no recording of a controller.
        """
        self.path = path
        self.events: dict[int, dict[str, Any]] = {}
        self.memories: dict[int, str] = {}
        self.about: dict[str, Any] = {}
        self.counts: dict[int, int] = {}
        self.first = self.last = -1
        self.start = self.end = self.count = 0
        contents, urdf = Contents(), ""
        try:
            for number, time, payload in read(path, contents):
                self.counts[number] = self.counts.get(number, 0) + 1
                kind = _kind(contents.channels[number])
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
                    self._understand()
                elif kind == "events":
                    event = from_json(_text(payload))
                    self.events[int(event["cycle"])] = {**event, "time": time}
                elif kind == "memory":
                    self.memories[int(from_json_number(_text(payload)))] = _text(payload)
        except OSError as error:
            raise ConfigurationError(f"recording {path}: cannot be read: {error.strerror or error}") from error
        except (ValueError, KeyError, IndexError, InputRefused) as error:
            raise ConfigurationError(f"recording {path}: {error}") from error
        self.torn, self.channels = contents.torn, contents.channels
        if not self.about or not urdf:
            raise ConfigurationError(
                f"recording {path}: not a recording of this controller: it has no topic …/{OWN}/start"
                + (f"; {self.torn}" if self.torn else "")
            )
        self.config = self.configured(self.about["config"], urdf)

    def _understand(self) -> None:
        if self.about["format"] != FORMAT:
            raise ValueError(f"its format is {self.about['format']!r}; this version reads {FORMAT}")
        self.slots = tuple(Slot(*each) for each in self.about["layout"])
        self._groups = {
            name: [s for s in self.slots if s.group == name] for name in dict.fromkeys(s.group for s in self.slots)
        }

    def _cycle_size(self) -> int:
        return sum(slot.size for slot in self._groups["cycle"])

    def configured(self, text: str, urdf: str | None = None) -> Config:
        """The configuration that some text of the recording holds; an empty one is that of the start.

        Raises:
            ConfigurationError: where this version does not take it.
        """
        if not text:
            return self.config
        import yaml

        tree = next(iter(yaml.safe_load(text).values()))["ros__parameters"]
        source = f"the configuration in {self.path}"
        return Config(parse_settings(tree, source), source, self.config.urdf if urdf is None else urdf)

    def cycles(self, first: int = 0) -> Iterator[Cycle]:
        """The cycles, from a number on."""
        groups = self._groups
        sizes = {name: sum(slot.size for slot in slots) for name, slots in groups.items()}
        *_, end = [name for name in groups if name != "references"]
        contents = Contents()
        found: dict[str, Array] = {}
        references: Mapping[str, Array] = {}
        waiting: Cycle | None = None
        for number, time, payload in read(self.path, contents):
            kind = _kind(contents.channels[number])
            if kind not in groups:
                continue
            row = _numbers(payload, sizes[kind], sizes[kind])
            if kind == "references":
                references = split(groups[kind], row)
                if waiting is not None and int(references["number"][0]) == waiting.number:
                    waiting = Cycle(waiting.number, waiting.time, waiting.values, references)
                continue
            if kind == "cycle":
                if waiting is not None:
                    yield waiting
                    waiting = None
                found = {}
            found |= split(groups[kind], row)
            if kind == end and "number" in found and int(found["number"][0]) >= first:
                waiting = Cycle(int(found["number"][0]), time, found, references)
        if waiting is not None:
            yield waiting

    def memory_before(self, cycle: int) -> int | None:
        """The last cycle before which the memory is known, up to the one given."""
        known = sorted(self.memories)
        place = bisect.bisect_right(known, cycle)
        return known[place - 1] if place else None

    def memory_after(self, cycle: int) -> int | None:
        """The first cycle from the one given on before which the memory is known."""
        return next((each for each in sorted(self.memories) if each >= cycle), None)

    @property
    def faults(self) -> list[NamedFault]:
        """Every fault, in order, each once."""
        found: list[NamedFault] = []
        before: Fault | None = None
        for cycle in sorted(self.events):
            event = self.events[cycle]
            if "fault" not in event:
                continue
            fault = event["fault"]
            if fault is not None and before is not None and fault.code == before.code:
                found[-1] = NamedFault(found[-1].cycle, found[-1].time, fault)  # now it is explained
            elif fault is not None:
                found.append(NamedFault(cycle, event["time"], fault))
            before = fault
        return found

    def topics(self) -> Sequence[tuple[str, str, int]]:
        """Name, type and number of messages of each topic that has any."""
        return [(c.topic, c.type, self.counts[number]) for number, c in self.channels.items() if number in self.counts]


def from_json_number(text: str) -> float:
    """The number of the cycle that a memory stands before."""
    return float(text[text.index(":") + 1 : text.index(",")])


def _kind(channel: Channel) -> str:
    before, _, name = channel.topic.rpartition("/")
    return name if before.endswith(f"/{OWN}") else ""


def _numbers(payload: bytes, count: int, size: int) -> Array:
    """The first numbers of a serialized array of some size."""
    at = len(payload) - 8 * size
    if at < 0:
        raise ValueError("a cycle has fewer numbers than its layout")
    row: Array = np.frombuffer(payload, dtype="<f8", count=count, offset=at)
    return row


def _text(payload: bytes) -> str:
    return str(decode(payload, _STRING).data)
