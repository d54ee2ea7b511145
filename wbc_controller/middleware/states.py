"""Decoders of joint states, odometry, IMU, absolute poses and contact forces."""

import math
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from wbc_controller.arguments import finite, unit_quaternion
from wbc_controller.errors import InputRefused
from wbc_controller.middleware.codec import START, MessageLayout, decode, encode
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
#: Largest angular velocity, rad/s, and specific force, m/s², of an IMU, and component of a contact force, N.
MAX_IMU_RATE, MAX_IMU_FORCE, MAX_CONTACT_FORCE = 100.0, 1000.0, 1.0e5
#: Valid frames, largest distance, m, and largest variance, m² and rad², of absolute poses.
POSE_FRAMES = ("", "world", "map")
MAX_POSE_DISTANCE, MAX_POSE_VARIANCE = 1.0e4, 100.0
_ROUNDING = -1.0e-9  # smallest eigenvalue of a covariance, relative to its trace
_USED = [0, 1, 2, 5]  # position and heading


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
        return header_stamp(payload), np.frombuffer(payload, np.float64, layout.count, START)[self._index]

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


def _axes(path: str, axes: str = "xyz") -> tuple[str, ...]:
    return tuple(f"{path}.{axis}" for axis in axes)


_POSE = (*_axes("pose.pose.position"), *_axes("pose.pose.orientation", "xyzw"))


class BaseState(NamedTuple):
    """Measured state of a floating base."""

    stamp: int  # ns
    pose: Array  # position in m and quaternion x, y, z, w in the world, (7,)
    twist: Array  # linear and angular velocity in the base frame, (6,) in m/s and rad/s


class ImuData(NamedTuple):
    """Measurement of an IMU, in its axes."""

    stamp: int  # ns
    angular_velocity: Array  # (3,) in rad/s
    specific_force: Array  # acceleration minus gravity, (3,) in m/s²


class AbsolutePose(NamedTuple):
    """Measured pose of the base in the world."""

    stamp: int  # ns
    pose: Array  # position in m and quaternion x, y, z, w, (7,)
    covariance: Array  # of position and rotations about the world's axes, (6, 6) in m² and rad²


class ContactForce(NamedTuple):
    """Measured force on the robot at a contact."""

    stamp: int  # ns
    normal: float  # component along the contact's normal, N


class OdometryReader(StateReader):
    """Decoder of nav_msgs/Odometry."""

    type = "nav_msgs/msg/Odometry"
    paths = (*_POSE, *_axes("twist.twist.linear"), *_axes("twist.twist.angular"))

    def read(self, payload: bytes) -> BaseState:
        """See `StateReader`."""
        stamp, values = self._decode(payload)
        pose, twist = values[:7], values[7:]
        if not is_finite(values):
            finite(pose, "the pose")
            finite(twist, "the twist")
        pose[3:] = unit_quaternion(pose[3:], "the orientation ")
        return BaseState(stamp, pose, twist)

    def _check_text(self, content: Any) -> None:
        frame = content.child_frame_id
        if frame not in ("", self._frame):
            raise InputRefused(f"child_frame_id is {frame!r}; the robot's base link is {self._frame!r}")


class ImuReader(StateReader):
    """Decoder of sensor_msgs/Imu without the orientation."""

    type = "sensor_msgs/msg/Imu"
    paths = (
        *_axes("angular_velocity"), "angular_velocity_covariance",
        *_axes("linear_acceleration"), "linear_acceleration_covariance",
    )  # fmt: skip

    def read(self, payload: bytes) -> ImuData:
        """See `StateReader`."""
        stamp, values = self._decode(payload)
        rate, force = values[:12], values[12:]  # three components, and nine of the covariance
        _check_measured("angular_velocity", rate[:3], rate[3:], MAX_IMU_RATE, "rad/s")
        _check_measured("linear_acceleration", force[:3], force[3:], MAX_IMU_FORCE, "m/s²")
        return ImuData(stamp, rate[:3], force[:3])

    def _check_text(self, content: Any) -> None:
        _require_frame(content, ("", self._frame), f"it must be the IMU's frame {self._frame!r}")


class PoseReader(StateReader):
    """Decoder of geometry_msgs/PoseWithCovarianceStamped, absolute poses of the base in the world."""

    type = "geometry_msgs/msg/PoseWithCovarianceStamped"
    paths = (*_POSE, "pose.covariance")

    def read(self, payload: bytes) -> AbsolutePose:
        """See `StateReader`."""
        stamp, values = self._decode(payload)
        pose = finite(values[:7], "the pose")
        place = pose[:3]
        if not (np.abs(place) <= MAX_POSE_DISTANCE).all():
            raise InputRefused(
                f"the position is {place.tolist()} m (limit {MAX_POSE_DISTANCE:g} m from the world's origin)"
            )
        pose[3:] = unit_quaternion(pose[3:], "the orientation ")
        return AbsolutePose(stamp, pose, _checked_covariance(values[7:]))

    def _check_text(self, content: Any) -> None:
        _require_frame(content, POSE_FRAMES, f"valid for an absolute pose: {', '.join(POSE_FRAMES[1:])}")


class ContactForceReader(StateReader):
    """Decoder of a force sensor's geometry_msgs/WrenchStamped; `normals` are unit normals, (3,), by valid frame."""

    type = "geometry_msgs/msg/WrenchStamped"
    paths = _axes("wrench.force")

    def __init__(self, contact: str, normals: Mapping[str, Array]) -> None:
        super().__init__()
        self._contact, self._normals, self._normal = contact, normals, np.zeros(3)

    def read(self, payload: bytes) -> ContactForce:
        """See `StateReader`."""
        stamp, force = self._decode(payload)
        finite(force, "wrench.force")
        if not (np.abs(force) <= MAX_CONTACT_FORCE).all():
            raise InputRefused(f"wrench.force is {force.tolist()} N (limit {MAX_CONTACT_FORCE:g} N)")
        return ContactForce(stamp, float(self._normal @ force))

    def _check_text(self, content: Any) -> None:
        frames = ", ".join(sorted(filter(None, self._normals)))
        _require_frame(content, self._normals, f"valid for the force at contact {self._contact!r}: {frames}")
        self._normal = self._normals[content.header.frame_id]


def _require_frame(content: Any, valid: Collection[str], remedy: str) -> None:
    if content.header.frame_id not in valid:
        raise InputRefused(f"header.frame_id is {content.header.frame_id!r}; {remedy}")


def _check_measured(what: str, values: Array, covariance: Array, limit: float, unit: str) -> None:
    if covariance[0] == -1.0:
        raise InputRefused(f"{what}_covariance begins with -1: the IMU does not measure {what}")
    finite(values, what)
    if not (np.abs(values) <= limit).all():
        raise InputRefused(f"{what} is {values.tolist()} {unit} (limit {limit:g})")


def _checked_covariance(rows: Array) -> Array:
    C = finite(rows, "the covariance").reshape(6, 6)
    C += C.T.copy()
    C *= 0.5
    variances = C.diagonal()
    if not (variances >= 0.0).all():
        raise InputRefused(f"the covariance has the variances {variances.tolist()}; they must not be negative")
    if not (variances[_USED] <= MAX_POSE_VARIANCE).all():
        raise InputRefused(
            f"the covariance has the variances {variances.tolist()} (limit {MAX_POSE_VARIANCE:g} m² and rad² for "
            "position and heading)"
        )
    used = C[np.ix_(_USED, _USED)]
    smallest = float(np.linalg.eigvalsh(used)[0])
    if not smallest >= _ROUNDING * float(np.trace(used)):
        raise InputRefused(f"the covariance of position and heading has the negative eigenvalue {smallest:.3g}")
    return C
