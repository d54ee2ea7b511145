"""Reads the streams of measured states: in place, where a message has the shape of the one before."""

from __future__ import annotations

import sys
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from wbc_controller.compiled import Bound
from wbc_controller.errors import InputRefused
from wbc_controller.middleware import decoding
from wbc_controller.middleware.codec import decode
from wbc_controller.middleware.in_place import FixedShape, bytes_at
from wbc_controller.middleware.joint_order import JointOrder
from wbc_controller.middleware.message_kernels import read
from wbc_controller.records import Array

_POSITION, _ORIENTATION = "pose.pose.position.", "pose.pose.orientation."
_LINEAR, _ANGULAR = "twist.twist.linear.", "twist.twist.angular."
_NOWHERE = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True, slots=True)
class _Places:
    """Positions of the two groups of numbers in the messages of a stream, for `message_kernels.read`.

    Attributes:
        first: places of the numbers of the first group, (k,).
        second: of the second, (m,).
        first_largest: the largest magnitude that a number of the first group may have.
        second_largest: likewise.
        quaternion: index in the first group of a unit quaternion, which is normalized; -1 where there is none.
        unmeasured: places of numbers that are not -1, which says that there is no measurement.
    """

    first: np.ndarray
    second: np.ndarray = field(default_factory=lambda: _NOWHERE)
    first_largest: float = sys.float_info.max
    second_largest: float = sys.float_info.max
    quaternion: int = -1
    unmeasured: np.ndarray = field(default_factory=lambda: _NOWHERE)


class StateReader(ABC):
    """Reads one stream of states.

    Messages are read by the codec, and checked, until two in a row have the same size. From then on those of the same
    shape are read in place, in one kernel, which gives the same values; a message of another shape, or with a value
    that is refused, is read by the codec again.

    Attributes:
        known: the shape, and the places of its numbers, for `message_kernels.read`; None before two such messages.
    """

    type: str

    def __init__(self) -> None:
        self._shape: FixedShape | None = None
        self.known: Bound | None = None
        self._sizes = 0, 0
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
        if self.known is not None:
            sizes = self._sizes
            first, second = np.empty(sizes[0]), np.empty(sizes[1])
            stamp = read(payload, self.known.table, first, second)
            if stamp >= 0:
                return stamp, first, second
        return self._read(payload)

    def _read(self, payload: bytes) -> tuple[int, Array, Array]:
        """Read a message by the codec, and learn its shape."""
        content = decode(payload, self.type)
        q, v = self._by_codec(content)
        stamp = decoding.stamp_of(content)
        if len(payload) != self._size:
            self._size = len(payload)
            return stamp, q, v
        shape = FixedShape(content)
        if shape.fits(payload):  # it does not where a writer leaves other bytes than zero between fields
            self._shape, places = shape, self._find(shape)
            sizes = self._sizes = len(places.first), len(places.second)
            stamped = int(bytes_at(shape.place("header.stamp"))[0])
            self.known = Bound(
                len(shape.like), len(shape.edges), len(places.unmeasured), *sizes, stamped, places.quaternion,
                np.frombuffer(shape.like, dtype=np.int8), shape.edges, places.unmeasured, places.first, places.second,
                np.array([places.first_largest, places.second_largest]),
            )  # fmt: skip
        return stamp, q, v

    @abstractmethod
    def _by_codec(self, content: Any) -> tuple[Array, Array]:
        """What a message tells."""

    @abstractmethod
    def _find(self, shape: FixedShape) -> _Places:
        """Find the values of the last message in its shape."""


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

    def _by_codec(self, content: Any) -> tuple[Array, Array]:
        columns = self._order.columns(content, *self._columns)
        return columns[0], columns[1] if len(columns) > 1 else np.zeros(0)

    def _find(self, shape: FixedShape) -> _Places:
        columns = [bytes_at(shape.place(column).start + self._order.index) for column in self._columns]
        return _Places(columns[0], columns[1] if len(columns) > 1 else _NOWHERE)


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

    def _by_codec(self, content: Any) -> tuple[Array, Array]:
        return decoding.read_odometry(content, self._base_link)

    def _find(self, shape: FixedShape) -> _Places:
        twist = shape.place(*(kind + axis for kind in (_LINEAR, _ANGULAR) for axis in "xyz"))
        return _Places(bytes_at(_pose_in(shape)), bytes_at(twist), quaternion=3)


def _pose_in(shape: FixedShape) -> slice:
    return shape.place(*(_POSITION + axis for axis in "xyz"), *(_ORIENTATION + axis for axis in "xyzw"))


class PoseReader(StateReader):
    """Reads geometry_msgs/PoseWithCovarianceStamped: position and quaternion in the world, (7,); covariance, (6, 6)."""

    type = "geometry_msgs/msg/PoseWithCovarianceStamped"

    def read(self, payload: bytes) -> tuple[int, Array, Array]:
        """As `StateReader.read`."""
        stamp, pose, covariance = super().read(payload)
        if covariance.ndim == 1:  # it was read in place
            try:
                return stamp, *decoding.checked_pose(pose, covariance)
            except InputRefused:
                return self._read(payload)  # the codec's way says it in full
        return stamp, pose, covariance

    def _by_codec(self, content: Any) -> tuple[Array, Array]:
        return decoding.read_pose(content)

    def _find(self, shape: FixedShape) -> _Places:
        return _Places(bytes_at(_pose_in(shape)), bytes_at(shape.place("pose.covariance")))


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

    def _by_codec(self, content: Any) -> tuple[Array, Array]:
        return decoding.read_imu(content, self._frame)

    def _find(self, shape: FixedShape) -> _Places:
        turning = shape.place(*("angular_velocity." + axis for axis in "xyz"))
        force = shape.place(*("linear_acceleration." + axis for axis in "xyz"))
        covariances = ("angular_velocity_covariance", "linear_acceleration_covariance")
        return _Places(
            bytes_at(turning), bytes_at(force), decoding.FASTEST_IMU, decoding.HARDEST_IMU,
            unmeasured=bytes_at(np.array([shape.place(name).start for name in covariances])),
        )  # fmt: skip


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

    def read(self, payload: bytes) -> tuple[int, Array, Array]:
        """As `StateReader.read`."""
        stamp, along, force = super().read(payload)
        if not len(force):  # it was read in place: the force alone
            return stamp, np.array([self._normal @ along]), along
        return stamp, along, force

    def _by_codec(self, content: Any) -> tuple[Array, Array]:
        force, self._last = decoding.read_contact_force(content, self._contact, self._normals)
        return np.array([self._last @ force]), force

    def _find(self, shape: FixedShape) -> _Places:
        self._normal = self._last
        return _Places(
            bytes_at(shape.place(*("wrench.force." + axis for axis in "xyz"))), first_largest=decoding.HARDEST_CONTACT
        )
