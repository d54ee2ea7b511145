"""Messages of a fixed shape, read and written in place: from one to the next only their numbers change.

The codec of `middleware.codec` makes an object of every message. A stream such as joint states repeats itself in all
but its stamp and its arrays: where these stand is found once, with that codec, and then only the bytes around them are
compared, by the kernels of `middleware.message_kernels`.
"""

from __future__ import annotations

import dataclasses
import itertools
import struct
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from wbc_controller.middleware.codec import encode
from wbc_controller.middleware.message_kernels import write, write_product
from wbc_controller.records import Array

_STAMP = struct.Struct("<iI")
#: Bytes of the encapsulation header; what follows is aligned, so that numbers stand at multiples of eight after it.
_START = 4
#: Two fillings of a message's numbers that differ in every byte.
_FILLINGS = (0x11, 0x22)
_NONE = np.zeros(0)


class FixedShape:
    """Where the numbers of a message stand in its serialized bytes.

    Numbers are the stamp of its header, floating-point fields, and arrays of them. All other bytes are its shape:
    sizes, names, frames.
    """

    def __init__(self, content: Any) -> None:
        """Find them.

        Args:
            content: a message made by `middleware.codec.message` or `decode`.
        """
        first, second = (np.frombuffer(encode(_filled(content, byte)), dtype=np.uint8) for byte in _FILLINGS)
        varies = first != second
        bytes_of_numbers = np.flatnonzero(varies)
        self._places: dict[str, slice] = {}
        seen = 0
        for path, count in _numbers(content):
            if count:
                start = (int(bytes_of_numbers[seen]) - _START) // 8
                self._places[path] = slice(start, start + count)
                seen += 8 * count
        edges = np.flatnonzero(np.diff(np.concatenate([[True], varies, [True]]))).tolist()
        #: A message of this shape, and the begin and end of each piece of it in which all of them agree, (2 n,).
        self.like, self.edges = first.tobytes(), np.array(edges, dtype=np.int64)

    def fits(self, payload: bytes) -> bool:
        """Whether a serialized message has this shape."""
        return len(payload) == len(self.like) and all(
            payload[start:stop] == self.like[start:stop] for start, stop in self.edges.reshape(-1, 2).tolist()
        )

    def place(self, *paths: str) -> slice:
        """Where numbers stand, counted in units of eight bytes; `bytes_at` says where that is in the bytes.

        Args:
            paths: such as ``position`` or ``pose.pose.position.x``; several directly follow one another. A stamp is the
                path of one number, to be read by `read_stamp`.

        Raises:
            KeyError: where the message has no such numbers.
            ValueError: where they do not follow one another.
        """
        places = [self._places[path] for path in paths]
        if any(before.stop != after.start for before, after in itertools.pairwise(places)):
            raise ValueError(f"{', '.join(paths)} do not follow one another")
        return slice(places[0].start, places[-1].stop)


def bytes_at(place: slice | np.ndarray) -> np.ndarray:
    """Where the first byte of each number at places of a `FixedShape` stands in its bytes, (k,)."""
    index = np.arange(place.start, place.stop) if isinstance(place, slice) else place
    return _START + 8 * index.astype(np.int64)


def read_stamp(payload: bytes, place: slice) -> tuple[int, int]:
    """Seconds and nanoseconds of the stamp at a place of `FixedShape`."""
    seconds, nanoseconds = _STAMP.unpack_from(payload, _START + 8 * place.start)
    return seconds, nanoseconds


class Template:
    """Serializes messages that differ in some numbers alone."""

    def __init__(self, content: Any, *fields: Sequence[str]) -> None:
        """Lay out a message.

        Args:
            content: a message of the shape; numbers that are not named in `fields`, its stamp aside, keep their values.
            fields: the numbers that `write` takes, each by the paths of numbers that follow one another; three of them
                at most.
        """
        shape, payload = FixedShape(content), encode(content)
        # The kernel takes aligned numbers: the four bytes before them are the last of a number that is none.
        room = np.zeros(len(payload) // 8 + 2)
        self._payload = room.view(np.uint8)[_START : _START + len(payload)]
        self._payload[:] = np.frombuffer(payload, dtype=np.uint8)
        stamp = shape.place("header.stamp").start if hasattr(content, "header") else -1
        self._numbers, self._stamp = room[1:], stamp
        places = [shape.place(*paths) for paths in fields] + [slice(0, 0)] * (3 - len(fields))
        self._fields = np.array([[place.start, place.stop] for place in places], dtype=np.int64).reshape(-1)

    def write(self, nanoseconds: int, one: Array = _NONE, two: Array = _NONE, three: Array = _NONE) -> bytes:
        """Serialize a message.

        Args:
            nanoseconds: the stamp, ns; without effect in a message without a header.
            one: the numbers of the first field, of its size; likewise the next ones.
            two: of the second field.
            three: of the third field.

        Raises:
            ValueError: where they have another size.
        """
        if not write(self._numbers, self._stamp, nanoseconds, self._fields, one, two, three):
            raise ValueError(f"{len(one)}, {len(two)} and {len(three)} numbers for the fields {self._fields}")
        return self._payload.tobytes()

    def write_product(self, nanoseconds: int, matrix: Array, vector: Array) -> bytes:
        """Serialize a message whose only field is a product.

        Args:
            nanoseconds: the stamp, ns; without effect in a message without a header.
            matrix: (m, k), for a field of m numbers.
            vector: (k,).

        Raises:
            ValueError: where they have another size.
        """
        if not write_product(self._numbers, self._stamp, nanoseconds, self._fields, matrix, vector):
            raise ValueError(f"a matrix {matrix.shape} and {len(vector)} numbers for the field {self._fields[:2]}")
        return self._payload.tobytes()


def _is_message(value: object) -> bool:
    return hasattr(value, "__msgtype__")


def _is_stamp(value: Any) -> bool:
    return getattr(value, "__msgtype__", "") == "builtin_interfaces/msg/Time"


def _numbers(content: Any, path: str = "") -> Iterator[tuple[str, int]]:
    """The path of each field of numbers, in the order of serialization, and its size in units of eight bytes."""
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
    """A copy of a message, every byte of its numbers set."""
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
