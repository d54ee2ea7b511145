"""Serialized reads and writes with the internal functions of cyclonedds (11.0), which only this file uses.

The public ``write`` and ``take`` convert every message field by field in Python, which takes twice as long as our
codec. The public ``WaitSet.wait`` returns how many readers have data, but not which, so that each message would require
a check of all readers. Both are thin wrappers around the functions used here.
"""

from __future__ import annotations

import ctypes
import math
from typing import Any

from cyclonedds._clayer import ddspy_take, ddspy_take_endpoint, ddspy_write
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import DDSException, InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.internal import dds_c_t, dds_infinity

_ANY = SampleState.Any | ViewState.Any | InstanceState.Any
_ENCAPSULATION = 4  # bytes of header before the fields; the C code does not check for them


def write(writer: Any, payload: bytes) -> None:
    """Send one serialized message.

    Raises:
        DDSException: if it could not be sent.
        ValueError: if the bytes cannot be a serialized message.
    """
    size = len(payload)
    if size < _ENCAPSULATION:
        raise ValueError(f"{size} bytes are not a serialized message")
    if size % 4:
        payload = payload.ljust(-(-size // 4) * 4, b"\0")  # DDS counts payloads in words of four bytes
    status = ddspy_write(writer._ref, payload)
    if status < 0:
        raise DDSException(status)


def take(reader: Any, limit: int) -> list[bytes]:
    """Take the serialized messages from a reader's queue, oldest first.

    Raises:
        DDSException: if the reader could not be read.
    """
    samples = ddspy_take(reader._ref, _ANY, limit)
    if isinstance(samples, int):
        raise DDSException(samples)
    # A sample without valid data only reports that its writer is gone.
    if len(samples) == 1:  # in nearly every cycle
        payload, info = samples[0]
        return [payload] if info.valid_data else []
    return [payload for payload, info in samples if info.valid_data]


def writers_reader(participant: Any) -> Any:
    """Make a reader for `take_writers`."""
    return BuiltinDataReader(participant, BuiltinTopicDcpsPublication)


def take_writers(reader: Any, limit: int) -> list[tuple[bytes, bytes, str | None]]:
    """Take what has changed about the writers of the domain: about 4 µs for each, as their QoS is not converted.

    Returns:
        GUID of the writer, GUID of its participant, and the topic's name; None where the writer is gone.

    Raises:
        DDSException: if the reader could not be read.
    """
    samples = ddspy_take_endpoint(reader._ref, limit, lambda *values: values, lambda qos: None)
    if isinstance(samples, int):
        raise DDSException(samples)
    return [
        (guid, owner, topic if info.instance_state == InstanceState.Alive else None)
        for guid, owner, _, topic, _, _, info, _ in samples
    ]


def delete(entity: Any) -> None:
    """Delete an entity now, not with the last reference to its Python object. Deleting it twice is harmless."""
    entity.__del__()


class Triggers:
    """Waits for readers and guard conditions, and reports which have triggered. Any thread may attach, one waits."""

    def __init__(self, participant: Any) -> None:
        self._waitset = WaitSet(participant)
        self._attached: list[Any] = []
        self._numbers = (dds_c_t.attach * 0)()  # takes what has triggered
        self._count = 0

    def attach_guard(self, guard: Any) -> int:
        """Attach a guard condition; returns the number by which `triggered` reports it."""
        return self._attach(guard)

    def attach_reader(self, reader: Any) -> int:
        """Attach a reader; returns the number by which `triggered` reports it while it holds messages."""
        return self._attach(ReadCondition(reader, _ANY))

    def wait(self, seconds: float = math.inf) -> bool:
        """Block until an attached entity has triggered, or the time is over; whether one has."""
        numbers = self._numbers
        timeout = dds_infinity if seconds == math.inf else round(1e9 * seconds)
        count = self._waitset._waitset_wait(self._waitset._ref, numbers, len(numbers), timeout)
        if count < 0:
            raise DDSException(count)
        self._count = count
        return bool(count)

    def triggered(self) -> list[int]:
        """The numbers of some that have triggered in the last wait."""
        numbers = self._numbers
        return [number for number in numbers[: min(self._count, len(numbers))] if number is not None]

    def delete(self) -> None:
        """Delete the conditions and the wait set."""
        delete(self._waitset)
        for condition in self._attached:
            delete(condition)

    def _attach(self, condition: Any) -> int:
        # Appended first, as the number may be reported at once. Numbers start at 1: C returns 0 as a null pointer.
        self._attached.append(condition)
        number = len(self._attached)
        self._numbers = (dds_c_t.attach * number)()  # whoever waits goes on with the one before
        status = self._waitset._waitset_attach(self._waitset._ref, condition._ref, ctypes.c_void_p(number))
        if status < 0:
            raise DDSException(status)
        return number
