"""Byte offsets of numbers in serialized messages.

Messages of a stream differ only in their numbers: timestamp, floating-point fields and arrays. All other bytes (text
and array sizes) form the layout.
"""

import copy
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
        filled = copy.deepcopy(content)
        numbers = list(_numbers(filled))
        first, second = (np.frombuffer(_encode_filled(filled, numbers, byte), dtype=np.uint8) for byte in _FILLINGS)
        differs = first != second
        number_bytes = np.flatnonzero(differs)
        self._indices: dict[str, np.ndarray] = {}
        seen = 0
        for path, owner, name in numbers:
            count = np.size(getattr(owner, name))  # 1 for a timestamp
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
    """Serializer of messages with variable timestamp and numbers; `fields` are groups of consecutive paths."""

    def __init__(self, content: Any, *fields: Sequence[str]) -> None:
        layout = MessageLayout(content)
        self._payload = bytearray(encode(content))
        self._stamp = START + 8 * int(layout.index_of("header.stamp")[0]) if hasattr(content, "header") else None
        numbers = np.frombuffer(self._payload, np.float64, layout.count, START)
        self._fields = [numbers[_as_slice(layout.index_of(*paths))] for paths in fields]  # views

    def write(self, nanoseconds: int, *values: Array) -> bytes:
        """Serialize a timestamp (ignored without a header) and groups of numbers; wrong sizes raise `ValueError`."""
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


def _is_stamp(value: Any) -> bool:
    return getattr(value, "__msgtype__", "") == "builtin_interfaces/msg/Time"


def _numbers(content: Any, path: str = "") -> Iterator[tuple[str, Any, str]]:
    """Yield path, message and field of each timestamp, float and array of floats, in the order of serialization."""
    for field in dataclasses.fields(content):
        value, here = getattr(content, field.name), f"{path}{field.name}"
        if isinstance(value, float) or _is_stamp(value) or getattr(value, "dtype", None) == np.float64:
            yield here, content, field.name
        elif dataclasses.is_dataclass(value):
            yield from _numbers(value, f"{here}.")
        elif isinstance(value, list):
            for i, item in enumerate(value):
                if dataclasses.is_dataclass(item):
                    yield from _numbers(item, f"{here}[{i}].")


def _encode_filled(content: Any, numbers: Sequence[tuple[str, Any, str]], byte: int) -> bytes:
    """Serialize a message after filling all bytes of its numbers."""
    whole, number = (np.frombuffer(bytes([byte]) * 8, dtype=kind)[0].item() for kind in ("<u4", "<f8"))
    for _, owner, name in numbers:
        value = getattr(owner, name)
        if _is_stamp(value):
            value.sec = value.nanosec = whole
        else:
            setattr(owner, name, np.full_like(value, number) if isinstance(value, np.ndarray) else number)
    return encode(content)
