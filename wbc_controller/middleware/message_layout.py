"""Byte offsets of numbers in serialized messages.

Messages of a stream differ only in their numbers: timestamp, floating-point fields and arrays. All other bytes (text
and array sizes) form the layout.
"""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from wbc_controller.middleware.codec import encode
from wbc_controller.records import Array

_STAMP = struct.Struct("<iI")
START = 4  # bytes of the encapsulation header; CDR aligns the numbers after it to multiples of eight
_FILLINGS = (0x11, 0x22)  # two values for all bytes of numbers


class MessageLayout:
    """Positions of the numbers in serialized messages with equal text and array sizes.

    A message contains `count` doubles from the byte `START` on, some of them parts of text.
    """

    def __init__(self, content: Any) -> None:
        first, second = (np.frombuffer(encode(_filled(content, byte)), dtype=np.uint8) for byte in _FILLINGS)
        differs = first != second
        number_bytes = np.flatnonzero(differs)
        self._indices: dict[str, np.ndarray] = {}
        seen = 0
        for path, count in _numbers(content):
            if count:
                start = (int(number_bytes[seen]) - START) // 8
                self._indices[path] = np.arange(start, start + count)
                seen += 8 * count
        edges = np.flatnonzero(np.diff(np.concatenate([[True], differs, [True]]))).reshape(-1, 2).tolist()
        self._pieces = [slice(start, stop) for start, stop in edges]  # bytes outside the numbers
        self._constant = [first[piece].tobytes() for piece in self._pieces]
        self._size, self.count = len(first), (len(first) - START) // 8

    def fits(self, payload: bytes) -> bool:
        """Return True if a message has this layout."""
        return len(payload) == self._size and [payload[piece] for piece in self._pieces] == self._constant

    def index_of(self, *paths: str) -> np.ndarray:
        """Return the index of each number of fields such as ``pose.pose.position.x``, (k,).

        A timestamp counts as one number. A field without numbers raises `KeyError`.
        """
        return np.concatenate([self._indices[path] for path in paths])


class Template:
    """Serializer of messages with variable timestamp and numbers.

    Args:
        content: message with the other values.
        fields: groups of numbers for `write`, each with the paths of consecutive fields.
    """

    def __init__(self, content: Any, *fields: Sequence[str]) -> None:
        layout = MessageLayout(content)
        self._payload = bytearray(encode(content))
        self._stamp = START + 8 * int(layout.index_of("header.stamp")[0]) if hasattr(content, "header") else None
        numbers = np.frombuffer(self._payload, np.float64, layout.count, START)
        self._fields = [numbers[_as_slice(layout.index_of(*paths))] for paths in fields]  # views

    def write(self, nanoseconds: int, *values: Array) -> bytes:
        """Serialize a timestamp (ignored without a header) and the numbers of each group.

        Raises `ValueError` for a wrong number or size of groups.
        """
        if self._stamp is not None:
            _STAMP.pack_into(self._payload, self._stamp, *divmod(nanoseconds, 1_000_000_000))
        for field, numbers in zip(self._fields, values, strict=True):
            if len(numbers) != len(field):
                raise ValueError(f"{len(numbers)} numbers for a field of {len(field)}")
            field[:] = numbers
        return bytes(self._payload)


def _as_slice(index: np.ndarray) -> slice:
    start, stop = int(index[0]), int(index[-1]) + 1
    if not np.array_equal(index, np.arange(start, stop)):
        raise ValueError(f"the fields of a group must be consecutive; their indices are {index.tolist()}")
    return slice(start, stop)


def _is_message(value: object) -> bool:
    return hasattr(value, "__msgtype__")


def _is_stamp(value: Any) -> bool:
    return getattr(value, "__msgtype__", "") == "builtin_interfaces/msg/Time"


def _numbers(content: Any, path: str = "") -> Iterator[tuple[str, int]]:
    """Yield the path and size (in units of eight bytes) of each numeric field, in the order of serialization."""
    for field in dataclasses.fields(content):
        value, here = getattr(content, field.name), f"{path}{field.name}"
        if isinstance(value, float):
            yield here, 1
        elif isinstance(value, np.ndarray) and value.dtype == np.float64:
            yield here, value.size
        elif _is_stamp(value):
            yield here, 1
        elif _is_message(value):
            yield from _numbers(value, f"{here}.")
        elif isinstance(value, list):
            for i, item in enumerate(value):
                if _is_message(item):
                    yield from _numbers(item, f"{here}[{i}].")


def _filled(content: Any, byte: int) -> Any:
    whole, number = (np.frombuffer(bytes([byte]) * 8, dtype=kind)[0].item() for kind in ("<u4", "<f8"))
    changed: dict[str, Any] = {}
    for field in dataclasses.fields(content):
        value = getattr(content, field.name)
        if isinstance(value, float):
            changed[field.name] = number
        elif isinstance(value, np.ndarray) and value.dtype == np.float64:
            changed[field.name] = np.full(value.shape, number)
        elif _is_stamp(value):
            changed[field.name] = dataclasses.replace(value, **dict.fromkeys(("sec", "nanosec"), whole))
        elif _is_message(value):
            changed[field.name] = _filled(value, byte)
        elif isinstance(value, list):
            changed[field.name] = [_filled(item, byte) if _is_message(item) else item for item in value]
    return dataclasses.replace(content, **changed)
