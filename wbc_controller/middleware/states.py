"""Decoders of odometry, IMU, absolute poses and contact forces."""

from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

import numpy as np

from wbc_controller.arguments import finite
from wbc_controller.errors import InputRefused
from wbc_controller.inverse_dynamics.tasks.form import unit_quaternion
from wbc_controller.middleware.joint_states import StateReader, is_finite
from wbc_controller.records import Array

#: Largest angular velocity, rad/s, and specific force, m/s², of an IMU, and component of a contact force, N.
MAX_IMU_RATE, MAX_IMU_FORCE, MAX_CONTACT_FORCE = 100.0, 1000.0, 1.0e5
#: Valid frames, largest distance, m, and largest variance, m² and rad², of absolute poses.
POSE_FRAMES = ("", "world", "map")
MAX_POSE_DISTANCE, MAX_POSE_VARIANCE = 1.0e4, 100.0
_ROUNDING = -1.0e-9  # smallest eigenvalue of a covariance, relative to its trace
_USED = [0, 1, 2, 5]  # position and heading


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
