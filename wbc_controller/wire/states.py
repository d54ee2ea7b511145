"""Reads the streams of measured states: in place, where a message has the shape of the one before."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from wbc_controller.core.tasks.form import unit_quaternion
from wbc_controller.errors import InputRefused
from wbc_controller.records import Array
from wbc_controller.wire import decoding
from wbc_controller.wire.in_place import FixedShape, numbers, read_stamp
from wbc_controller.wire.joint_order import JointOrder
from wbc_controller.wire.messages import decode

_POSITION, _ORIENTATION = "pose.pose.position.", "pose.pose.orientation."
_LINEAR, _ANGULAR = "twist.twist.linear.", "twist.twist.angular."


class StateReader(ABC):
    """Reads one stream of states.

    Messages are read by the codec, and checked, until two in a row have the same size. From then on those of the same
    shape are read in place, which gives the same values; a message of another shape, or with a value that is refused,
    is read by the codec again.
    """

    type: str

    def __init__(self) -> None:
        self._shape: FixedShape | None = None
        self._stamp = slice(0)
        self._size = 0  # of the last message that was read by the codec

    def read(self, payload: bytes) -> tuple[int, Array, Array]:
        """Read a serialized message.

        Returns:
            The stamp in ns, and what the stream tells: positions and velocities; of an IMU or a force sensor what it
            measures.

        Raises:
            InputRefused: if the bytes are no such message, or it is not of this robot, or a value or the stamp is none
                that a state can have.
        """
        if self._shape is not None and self._shape.fits(payload):
            seconds, rest = read_stamp(payload, self._stamp)
            values = self._in_place(numbers(payload))
            if values is not None and seconds >= 0 and rest < 1_000_000_000:
                return seconds * 1_000_000_000 + rest, *values
        content = decode(payload, self.type)
        q, v = self._by_codec(content)
        stamp = decoding.stamp_of(content)
        self._learn(payload, content)
        return stamp, q, v

    def _learn(self, payload: bytes, content: Any) -> None:
        if len(payload) != self._size:
            self._size = len(payload)
            return
        shape = FixedShape(content)
        if shape.fits(payload):  # it does not where a writer leaves other bytes than zero between fields
            self._shape, self._stamp = shape, shape.place("header.stamp")
            self._find(shape)

    @abstractmethod
    def _by_codec(self, content: Any) -> tuple[Array, Array]:
        """What a message tells."""

    @abstractmethod
    def _find(self, shape: FixedShape) -> None:
        """Find the values of the last message in its shape."""

    @abstractmethod
    def _in_place(self, values: Array) -> tuple[Array, Array] | None:
        """What a message tells, from its numbers; None where the codec's way has to say that it is refused."""


class JointStateReader(StateReader):
    """Reads sensor_msgs/JointState by joint name: positions in rad and velocities in rad/s, (nj,) each.

    A reader that ignores velocities, which a message then need not have, gives an empty array in their place.
    """

    type = "sensor_msgs/msg/JointState"

    def __init__(self, joints: Sequence[str], *, velocities: bool = True) -> None:
        """Make a reader.

        Args:
            joints: names of the robot's joints, in its order.
            velocities: whether it reads velocities.
        """
        super().__init__()
        self._order = JointOrder(joints)
        self._columns = ("position", "velocity") if velocities else ("position",)
        self._index = np.zeros((len(self._columns), 0), dtype=np.intp)

    def _by_codec(self, content: Any) -> tuple[Array, Array]:
        return _pair(self._order.columns(content, *self._columns))

    def _find(self, shape: FixedShape) -> None:
        starts = [shape.place(column).start for column in self._columns]
        self._index = np.stack([start + self._order.index for start in starts])

    def _in_place(self, values: Array) -> tuple[Array, Array] | None:
        own = values[self._index]
        return _pair(list(own)) if math.isfinite(np.vdot(own, own)) else None  # of huge values the codec's way decides


def _pair(columns: Sequence[Array]) -> tuple[Array, Array]:
    """Positions, and velocities where they were read."""
    return columns[0], columns[1] if len(columns) > 1 else np.zeros(0)


class OdometryReader(StateReader):
    """Reads nav_msgs/Odometry: position and quaternion of the base in the world, (7,); its twist in its frame, (6,)."""

    type = "nav_msgs/msg/Odometry"

    def __init__(self, base_link: str) -> None:
        """Make a reader.

        Args:
            base_link: the frame whose twist it is.
        """
        super().__init__()
        self._base_link = base_link
        self._index = np.zeros(0, dtype=np.intp)  # of the pose, then of the twist

    def _by_codec(self, content: Any) -> tuple[Array, Array]:
        return decoding.read_odometry(content, self._base_link)

    def _find(self, shape: FixedShape) -> None:
        pose = shape.place(*(_POSITION + axis for axis in "xyz"), *(_ORIENTATION + axis for axis in "xyzw"))
        twist = shape.place(*(kind + axis for kind in (_LINEAR, _ANGULAR) for axis in "xyz"))
        self._index = np.r_[pose, twist]

    def _in_place(self, values: Array) -> tuple[Array, Array] | None:
        own = values[self._index]
        if not math.isfinite(np.vdot(own, own)):
            return None
        pose, twist = own[:7], own[7:]
        try:
            pose[3:] = unit_quaternion(pose[3:], "")
        except InputRefused:
            return None  # the codec's way says it in full
        return pose, twist


class PoseReader(StateReader):
    """Reads geometry_msgs/PoseWithCovarianceStamped: position and quaternion in the world, (7,); covariance, (6, 6)."""

    type = "geometry_msgs/msg/PoseWithCovarianceStamped"

    def __init__(self) -> None:
        super().__init__()
        self._pose = self._covariance = slice(0)

    def _by_codec(self, content: Any) -> tuple[Array, Array]:
        return decoding.read_pose(content)

    def _find(self, shape: FixedShape) -> None:
        self._pose = shape.place(*(_POSITION + axis for axis in "xyz"), *(_ORIENTATION + axis for axis in "xyzw"))
        self._covariance = shape.place("pose.covariance")

    def _in_place(self, values: Array) -> tuple[Array, Array] | None:
        try:
            return decoding.checked_pose(values[self._pose], values[self._covariance])
        except InputRefused:
            return None  # the codec's way says it


class ImuReader(StateReader):
    """Reads sensor_msgs/Imu: angular velocity in rad/s and specific force in m/s², (3,) each, in the IMU's axes."""

    type = "sensor_msgs/msg/Imu"

    def __init__(self, frame: str) -> None:
        """Make a reader.

        Args:
            frame: the frame of the IMU.
        """
        super().__init__()
        self._frame = frame
        self._turning = self._force = slice(0)
        self._unmeasured: tuple[int, ...] = ()  # places at which -1 says that there is no measurement

    def _by_codec(self, content: Any) -> tuple[Array, Array]:
        return decoding.read_imu(content, self._frame)

    def _find(self, shape: FixedShape) -> None:
        self._turning = shape.place(*("angular_velocity." + axis for axis in "xyz"))
        self._force = shape.place(*("linear_acceleration." + axis for axis in "xyz"))
        covariances = ("angular_velocity_covariance", "linear_acceleration_covariance")
        self._unmeasured = tuple(shape.place(name).start for name in covariances)

    def _in_place(self, values: Array) -> tuple[Array, Array] | None:
        if any(values[place] == -1.0 for place in self._unmeasured):
            return None
        turning, force = values[self._turning].copy(), values[self._force].copy()
        good = (np.abs(turning) <= decoding.FASTEST_IMU).all() and (np.abs(force) <= decoding.HARDEST_IMU).all()
        return (turning, force) if good else None


class ContactForceReader(StateReader):
    """Reads geometry_msgs/WrenchStamped at a contact: the force along its normal, (1,), and the force, (3,), in N."""

    type = "geometry_msgs/msg/WrenchStamped"

    def __init__(self, contact: str, normals: Mapping[str, Array]) -> None:
        """Make a reader.

        Args:
            contact: the contact's name.
            normals: its unit normal in the axes of each frame in which the force may be given, (3,).
        """
        super().__init__()
        self._contact, self._normals = contact, normals
        self._last = self._normal = np.zeros(3)
        self._force = slice(0)

    def _by_codec(self, content: Any) -> tuple[Array, Array]:
        force, self._last = decoding.read_contact_force(content, self._contact, self._normals)
        return np.array([self._last @ force]), force

    def _find(self, shape: FixedShape) -> None:
        self._force, self._normal = shape.place(*("wrench.force." + axis for axis in "xyz")), self._last

    def _in_place(self, values: Array) -> tuple[Array, Array] | None:
        force = values[self._force].copy()
        good = (np.abs(force) <= decoding.HARDEST_CONTACT).all()
        return (np.array([self._normal @ force]), force) if good else None
