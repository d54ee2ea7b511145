"""Serialized reads and writes with internals of cyclonedds (11.0).

The public ``write`` and ``take`` convert messages in Python, at half the speed of our codec; ``WaitSet.wait`` returns
only the number of triggered readers.
"""

import ctypes
import math
from typing import Any

from cyclonedds._clayer import ddspy_take, ddspy_take_endpoint, ddspy_write
from cyclonedds.core import DDSException, InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.internal import dds_c_t, dds_infinity

_ANY = SampleState.Any | ViewState.Any | InstanceState.Any
_ENCAPSULATION = 4  # header bytes, not checked by the C code


def write(writer: Any, payload: bytes) -> None:
    """Send one serialized message; raises `DDSException` on a failure and `ValueError` for too few bytes."""
    size = len(payload)
    if size < _ENCAPSULATION:
        raise ValueError(f"{size} bytes are not a serialized message")
    if size % 4:
        payload = payload.ljust(-(-size // 4) * 4, b"\0")  # DDS payloads are multiples of four bytes
    status = ddspy_write(writer._ref, payload)
    if status < 0:
        raise DDSException(status)


def take(reader: Any, limit: int) -> list[bytes]:
    """Take serialized messages, oldest first; raises `DDSException` on a failure."""
    samples = ddspy_take(reader._ref, _ANY, limit)
    if isinstance(samples, int):
        raise DDSException(samples)
    # Samples without valid data report the end of a writer.
    if len(samples) == 1:  # the usual case
        payload, info = samples[0]
        return [payload] if info.valid_data else []
    return [payload for payload, info in samples if info.valid_data]


def take_writers(reader: Any, limit: int) -> list[tuple[bytes, bytes, str | None]]:
    """Take the changes of the domain's writers (4 µs each) from a `BuiltinDataReader`; errors as for `take`.

    A change contains the GUIDs of the writer and its participant, and the topic's name, or None for a removed writer.
    """
    samples = ddspy_take_endpoint(reader._ref, limit, lambda *values: values, lambda qos: None)
    if isinstance(samples, int):
        raise DDSException(samples)
    return [
        (guid, owner, topic if info.instance_state == InstanceState.Alive else None)
        for guid, owner, _, topic, _, _, info, _ in samples
    ]


def delete(entity: Any) -> None:
    """Delete an entity, once."""
    entity.__del__()


class Triggers:
    """Wait set of readers and guard conditions that reports the triggered ones; any thread may attach, one waits."""

    def __init__(self, participant: Any) -> None:
        self._waitset = WaitSet(participant)
        self._attached: list[Any] = []
        self._numbers = (dds_c_t.attach * 0)()  # output of the wait
        self._count = 0

    def attach_reader(self, reader: Any) -> int:
        """Attach a reader; return its number."""
        return self.attach(ReadCondition(reader, _ANY))

    def attach(self, condition: Any) -> int:
        """Attach a condition; return its number."""
        # The number may trigger at once; 0 is a null pointer in C.
        self._attached.append(condition)
        number = len(self._attached)
        self._numbers = (dds_c_t.attach * number)()  # a waiting thread keeps the old array
        status = self._waitset._waitset_attach(self._waitset._ref, condition._ref, ctypes.c_void_p(number))
        if status < 0:
            raise DDSException(status)
        return number

    def wait(self, seconds: float = math.inf) -> bool:
        """Wait for a trigger; return False after the timeout."""
        numbers = self._numbers
        timeout = dds_infinity if seconds == math.inf else round(1e9 * seconds)
        count = self._waitset._waitset_wait(self._waitset._ref, numbers, len(numbers), timeout)
        if count < 0:
            raise DDSException(count)
        self._count = count
        return bool(count)

    def triggered(self) -> list[int]:
        """Return the numbers triggered in the last wait."""
        numbers = self._numbers
        return [number for number in numbers[: min(self._count, len(numbers))] if number is not None]

    def delete(self) -> None:
        """Delete the conditions and the wait set."""
        delete(self._waitset)
        for condition in self._attached:
            delete(condition)
