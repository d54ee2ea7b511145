"""Decoder of joint states."""

import math
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from wbc_controller.errors import InputRefused
from wbc_controller.middleware.codec import decode, encode
from wbc_controller.middleware.message_layout import START, MessageLayout
from wbc_controller.middleware.stamps import header_stamp
from wbc_controller.records import Array

_UNITS = {"position": "rad", "velocity": "rad/s", "effort": "N·m"}
_COLUMNS = tuple(_UNITS)
_NONE = np.zeros(0)
_SPLIT_HINT = (
    "; the joints are split over several messages: publish them in one, for example with the source_list of "
    "joint_state_publisher"
)
_VELOCITY_HINT = "for a robot without velocity sensors set estimation.joint_velocity to differentiated"


class JointStates(NamedTuple):
    """Measured joint states in the robot's joint order; ignored columns are empty."""

    stamp: int  # ns
    position: Array = _NONE  # (nj,) in rad
    velocity: Array = _NONE  # (nj,) in rad/s
    effort: Array = _NONE  # (nj,) in N·m


def is_finite(values: Array) -> bool:
    """Return True if all values are finite."""
    # A sum of floats takes a tenth of the time of NumPy's check.
    return math.isfinite(sum(values.tolist())) or bool(np.isfinite(values).all())


class StateReader(ABC):
    """Decoder of one state topic.

    The codec decodes the first message of each layout (text and array sizes); of later messages only the numbers are
    read and checked.
    """

    type: str
    paths: tuple[str, ...]  # fields of `_decode`, in order

    def __init__(self, frame: str = "") -> None:
        self._frame = frame  # link of the measured values
        self._layout: MessageLayout | None = None
        self._index = np.zeros(0, dtype=np.intp)  # of the values in the numbers of the layout

    @abstractmethod
    def read(self, payload: bytes) -> Any:
        """Decode a message into a record with its own arrays; raises `InputRefused` if invalid."""

    @abstractmethod
    def _check_text(self, content: Any) -> None:
        """Raise `InputRefused` for invalid names, frames or array sizes."""

    def _decode(self, payload: bytes) -> tuple[int, Array]:
        """Return the timestamp, ns, and the checked values at `paths`, (n,)."""
        layout = self._layout
        if layout is None or not layout.fits(payload):
            content = decode(payload, self.type)
            payload = encode(content)  # padding bytes may differ between writers
            if layout is None or not layout.fits(payload):
                self._check_text(content)
                layout = MessageLayout(content)
                self._index = self._index_in(layout, content)
                self._layout = layout
        numbers = np.frombuffer(payload, np.float64, layout.count, START)
        return header_stamp(payload), numbers[self._index]

    def _index_in(self, layout: MessageLayout, content: Any) -> np.ndarray:
        return np.concatenate([layout.index_of(path) for path in self.paths])


class JointStateReader(StateReader):
    """Decoder of sensor_msgs/JointState by joint name; additional joints are ignored. `columns` are adjacent."""

    type = "sensor_msgs/msg/JointState"

    def __init__(self, joints: Sequence[str], *columns: str) -> None:
        super().__init__()
        self._joints, self.paths = tuple(joints), columns or ("position", "velocity")
        self._ignored = (_NONE,) * _COLUMNS.index(self.paths[0])  # columns before the read ones
        self._partial: set[str] = set()  # joints of incomplete messages

    def read(self, payload: bytes) -> JointStates:
        """Decode a joint state; see `StateReader`."""
        stamp, values = self._decode(payload)
        columns = values.reshape(len(self.paths), -1)  # (k, nj)
        if not is_finite(values):
            k, i = np.argwhere(~np.isfinite(columns))[0]
            column, joint, value = self.paths[k], self._joints[i], columns[k, i]
            hint = f"; {_VELOCITY_HINT}" if column == "velocity" and np.isnan(columns[k]).all() else ""
            raise InputRefused(f"{column} of {joint!r} is {value} {_UNITS[column]}; every value must be finite{hint}")
        return JointStates(stamp, *self._ignored, *columns)

    def _check_text(self, content: Any) -> None:
        self._joint_indices(content.name)
        for column in self.paths:
            size = len(getattr(content, column))
            if column == "velocity" and size == 0:
                raise InputRefused(f"velocity has 0 values for {len(content.name)} names; {_VELOCITY_HINT}")
            if size != len(content.name):
                raise InputRefused(f"{column} has {size} values for {len(content.name)} names")

    def _index_in(self, layout: MessageLayout, content: Any) -> np.ndarray:
        order = self._joint_indices(content.name)
        return np.concatenate([layout.index_of(path)[order] for path in self.paths])

    def _joint_indices(self, names: Sequence[str]) -> np.ndarray:
        require_unique(names)
        missing = [name for name in self._joints if name not in names]
        if missing:
            unknown = ", ".join(name for name in names if name not in self._joints)
            self._partial.update(set(names).intersection(self._joints))
            raise InputRefused(
                f"{len(missing)} of {len(self._joints)} joints are missing: {', '.join(missing)}"
                + (f"; unknown joints: {unknown}" if unknown else "")
                + (_SPLIT_HINT if self._partial.issuperset(self._joints) else "")
            )
        return np.array([names.index(name) for name in self._joints], dtype=np.intp)


def require_unique(names: Sequence[str]) -> None:
    """Raise `InputRefused` for duplicate joints."""
    duplicates = sorted(name for name, count in Counter(names).items() if count > 1)
    if duplicates:
        raise InputRefused(f"duplicate joint {duplicates[0]!r}; name each joint once")
