"""The one place that reaches below the public surface of cyclonedds (11.0), and why.

Its public ``write`` and ``take`` convert every message field by field in Python, twice as slow as our codec; its public
``WaitSet.wait`` tells how many readers have data, but not which, so that each message would cost a look at all of them.
Both are thin covers over what is used here.
"""

from __future__ import annotations

import ctypes
from typing import Any

from cyclonedds._clayer import ddspy_take, ddspy_write
from cyclonedds.core import DDSException, InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.internal import dds_c_t, dds_infinity

_ANY = SampleState.Any | ViewState.Any | InstanceState.Any
_ENCAPSULATION = 4  # bytes of header before the fields; the C code below takes their presence for granted


def write(writer: Any, payload: bytes) -> None:
    """Send one serialized message.

    Raises:
        DDSException: where it could not be sent.
        ValueError: where the bytes cannot be a serialized message.
    """
    if len(payload) < _ENCAPSULATION:
        raise ValueError(f"{len(payload)} bytes are not a serialized message")
    # DDS counts payloads in words of four bytes.
    status = ddspy_write(writer._ref, payload.ljust(-(-len(payload) // 4) * 4, b"\0"))
    if status < 0:
        raise DDSException(status)


def take(reader: Any, limit: int) -> list[bytes]:
    """Take the serialized messages that wait in a reader, oldest first.

    Raises:
        DDSException: where the reader could not be read.
    """
    samples = ddspy_take(reader._ref, _ANY, limit)
    if isinstance(samples, int):
        raise DDSException(samples)
    # A sample without valid data tells that its writer has gone; there is nothing in it.
    return [payload for payload, info in samples if info.valid_data]


def delete(entity: Any) -> None:
    """Delete an entity now, not when the last reference to its Python object goes. Deleting twice does no harm."""
    entity.__del__()


class Triggers:
    """Waits for readers and guard conditions, and says which of them have something. Attach from any thread."""

    def __init__(self, participant: Any) -> None:
        self._waitset = WaitSet(participant)
        self._attached: list[Any] = []

    def attach_guard(self, guard: Any) -> int:
        """Attach a guard condition; returns the number by which `wait` reports it."""
        return self._attach(guard)

    def attach_reader(self, reader: Any) -> int:
        """Attach a reader; returns the number by which `wait` reports it while it holds messages."""
        return self._attach(ReadCondition(reader, _ANY))

    def wait(self) -> list[int]:
        """Block until something is attached that has triggered, and return the numbers of some that have."""
        room = len(self._attached)
        numbers = (dds_c_t.attach * room)()
        count = self._waitset._waitset_wait(self._waitset._ref, numbers, room, dds_infinity)
        if count < 0:
            raise DDSException(count)
        return [number for number in numbers[: min(count, room)] if number is not None]

    def delete(self) -> None:
        """Delete the conditions and the wait set."""
        delete(self._waitset)
        for condition in self._attached:
            delete(condition)

    def _attach(self, condition: Any) -> int:
        # The number is announced before it can be reported; zero would come back from C as a null pointer.
        self._attached.append(condition)
        number = len(self._attached)
        status = self._waitset._waitset_attach(self._waitset._ref, condition._ref, ctypes.c_void_p(number))
        if status < 0:
            raise DDSException(status)
        return number
