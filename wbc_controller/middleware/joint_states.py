"""Decoder of joint states, and the base class of all decoders of measured states."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from wbc_controller.errors import InputRefused
from wbc_controller.middleware.codec import decode, encode
from wbc_controller.middleware.message_layout import MessageLayout
from wbc_controller.middleware.stamps import header_stamp
from wbc_controller.records import Array

_UNITS = {"position": "rad", "velocity": "rad/s", "effort": "N·m"}
_NONE = np.zeros(0)
_SPLIT = (
    "; all joints arrive, but split over several messages: publish them in one, for example with the source_list of "
    "joint_state_publisher"
)
_UNMEASURED = "for a robot that measures no velocities, estimation.joint_velocity has to be differentiated"


class JointStates(NamedTuple):
    """Measured joint states in the robot's joint order."""

    stamp: int  # timestamp, ns
    position: Array = _NONE  # (nj,) in rad; like the other arrays it is empty if the reader ignores it
    velocity: Array = _NONE  # (nj,) in rad/s
    effort: Array = _NONE  # (nj,) in N·m


class StateReader(ABC):
    """Decoder of one stream of states.

    The first message of a layout, i.e. with new text or array sizes, passes the codec, and its text is checked. The
    offsets of its numbers hold for all messages of this layout: only their numbers are read and checked.
    """

    type: str
    #: Paths of the numbers and arrays that are read, in the order of the values that `_decode` returns.
    paths: tuple[str, ...]

    def __init__(self) -> None:
        self._layout: MessageLayout | None = None
        self._index = np.zeros(0, dtype=np.intp)  # of the values among the numbers of the layout

    @abstractmethod
    def read(self, payload: bytes) -> Any:
        """Decode and check a serialized message.

        Returns:
            The record of this stream, with arrays that own their data.

        Raises:
            InputRefused: if the bytes are not a message of this type and robot, or a value or the timestamp is invalid.
        """

    @abstractmethod
    def _check_text(self, content: Any) -> None:
        """Raise `InputRefused` if names, frames or array sizes of a decoded message are invalid."""

    def _decode(self, payload: bytes) -> tuple[int, Array]:
        """Return the timestamp in ns, and a new array of the values at `paths`, (n,).

        Raises:
            InputRefused: if the message has another type, invalid text or array sizes, or an invalid timestamp.
        """
        layout = self._layout
        if layout is None or not layout.fits(payload):
            content = decode(payload, self.type)
            payload = encode(content)  # another writer may leave other bytes between the fields
            if layout is None or not layout.fits(payload):
                self._check_text(content)
                layout = MessageLayout(content)
                self._index = self._index_in(layout, content)
                self._layout = layout
        numbers = np.frombuffer(memoryview(payload)[layout.span])
        return header_stamp(payload), numbers.take(self._index)

    def _index_in(self, layout: MessageLayout, content: Any) -> np.ndarray:
        """Return the index of each value among the numbers of a layout, (n,)."""
        return np.concatenate([layout.index_of(path) for path in self.paths])


class JointStateReader(StateReader):
    """Decoder of sensor_msgs/JointState, matched by joint name; additional joints are ignored.

    Args:
        columns: the arrays that are read: ``position``, ``velocity``, ``effort``; by default the first two.
    """

    type = "sensor_msgs/msg/JointState"

    def __init__(self, joints: Sequence[str], *columns: str) -> None:
        super().__init__()
        self._joints, self.paths = tuple(joints), columns or ("position", "velocity")
        self._partial: set[str] = set()  # joints of messages in which others are missing

    def read(self, payload: bytes) -> JointStates:
        """Decode and check a serialized message; see `StateReader.read`."""
        stamp, values = self._decode(payload)
        columns = values.reshape(len(self.paths), -1)  # (k, nj)
        if not np.isfinite(values).all():
            k, i = np.argwhere(~np.isfinite(columns))[0]
            column, joint = self.paths[k], self._joints[i]
            hint = f"; {_UNMEASURED}" if column == "velocity" and np.isnan(columns[k]).all() else ""
            raise InputRefused(
                f"{column} of {joint!r} is {columns[k, i]} {_UNITS[column]}; every value must be finite{hint}"
            )
        return JointStates(stamp, **dict(zip(self.paths, columns, strict=True)))

    def _check_text(self, content: Any) -> None:
        self._find(content.name)
        for column in self.paths:
            size = len(getattr(content, column))
            if column == "velocity" and size == 0:
                raise InputRefused(f"velocity has 0 values for {len(content.name)} names; {_UNMEASURED}")
            if size != len(content.name):
                raise InputRefused(f"{column} has {size} values for {len(content.name)} names")

    def _index_in(self, layout: MessageLayout, content: Any) -> np.ndarray:
        order = self._find(content.name)
        return np.concatenate([layout.index_of(path)[order] for path in self.paths])

    def _find(self, names: Sequence[str]) -> np.ndarray:
        """Return the index of each of the robot's joints in the names of a message, (nj,)."""
        require_unique(names)
        missing = [name for name in self._joints if name not in names]
        if missing:
            unknown = ", ".join(name for name in names if name not in self._joints)
            self._partial.update(set(names).intersection(self._joints))
            raise InputRefused(
                f"{len(missing)} of {len(self._joints)} joints are missing: {', '.join(missing)}"
                + (f"; unknown joints: {unknown}" if unknown else "")
                + (_SPLIT if self._partial.issuperset(self._joints) else "")
            )
        places = {name: i for i, name in enumerate(names)}
        return np.array([places[name] for name in self._joints], dtype=np.intp)


def require_unique(names: Sequence[str]) -> None:
    """Raise `InputRefused` if a joint is named more than once."""
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice:
        raise InputRefused(f"duplicate joint {twice[0]!r}; name each joint once")
