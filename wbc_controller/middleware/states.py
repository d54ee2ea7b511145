"""Decoders of measured states: odometry, IMU data, absolute poses and forces at contacts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from wbc_controller.arguments import finite
from wbc_controller.errors import InputRefused
from wbc_controller.inverse_dynamics.tasks.form import unit_quaternion
from wbc_controller.middleware.joint_states import StateReader
from wbc_controller.records import Array

#: Largest magnitudes that an IMU measures, rad/s and m/s², and largest component of a force at a contact, N.
FASTEST_IMU, HARDEST_IMU, HARDEST_CONTACT = 100.0, 1000.0, 1.0e5
#: Frames in which absolute poses may be given, and their farthest position and largest variance, m, m² and rad².
POSE_FRAMES = ("", "world", "map")
FARTHEST_POSE, VAGUEST_POSE = 1.0e4, 100.0
#: Smallest eigenvalue of a covariance, as a fraction of its trace: rounding.
_ROUNDED = -1.0e-9
#: The components of a covariance that are used: position and heading.
_USED = [0, 1, 2, 5]


def _axes(path: str, axes: str = "xyz") -> tuple[str, ...]:
    return tuple(f"{path}.{axis}" for axis in axes)


_POSE = (*_axes("pose.pose.position"), *_axes("pose.pose.orientation", "xyzw"))


class BaseState(NamedTuple):
    """Measured state of a floating base."""

    stamp: int  # timestamp, ns
    pose: Array  # position in m and quaternion x, y, z, w in the world, (7,)
    twist: Array  # linear and angular velocity in the base frame, (6,) in m/s and rad/s


class ImuData(NamedTuple):
    """One measurement of an IMU, in its own axes."""

    stamp: int  # timestamp, ns
    angular_velocity: Array  # (3,) in rad/s
    specific_force: Array  # acceleration less gravity, (3,) in m/s²


class AbsolutePose(NamedTuple):
    """Measured pose of the base in the world."""

    stamp: int  # timestamp, ns
    pose: Array  # position in m and quaternion x, y, z, w, (7,)
    covariance: Array  # of the position and of turns about the world's axes, (6, 6) in m² and rad²


class ContactForce(NamedTuple):
    """Measured force on the robot at a contact."""

    stamp: int  # timestamp, ns
    normal: float  # component along the contact's normal, N
    force: Array  # (3,) in N, in the axes of the message's frame


class OdometryReader(StateReader):
    """Decoder of nav_msgs/Odometry."""

    type = "nav_msgs/msg/Odometry"
    paths = (*_POSE, *_axes("twist.twist.linear"), *_axes("twist.twist.angular"))

    def __init__(self, base_link: str) -> None:
        super().__init__()
        self._base_link = base_link

    def read(self, payload: bytes) -> BaseState:
        """Decode and check a serialized message; see `StateReader.read`."""
        stamp, values = self._decode(payload)
        pose, twist = values[:7], values[7:]
        if not np.isfinite(values).all():
            finite(pose, "the pose")
            finite(twist, "the twist")
        pose[3:] = unit_quaternion(pose[3:], "the orientation ")
        return BaseState(stamp, pose, twist)

    def _check_text(self, content: Any) -> None:
        if content.child_frame_id not in ("", self._base_link):
            raise InputRefused(
                f"child_frame_id is {content.child_frame_id!r}; the robot's base link is {self._base_link!r}"
            )


class ImuReader(StateReader):
    """Decoder of sensor_msgs/Imu; its orientation is not used."""

    type = "sensor_msgs/msg/Imu"
    paths = (
        *_axes("angular_velocity"), "angular_velocity_covariance",
        *_axes("linear_acceleration"), "linear_acceleration_covariance",
    )  # fmt: skip

    def __init__(self, frame: str) -> None:
        super().__init__()
        self._frame = frame

    def read(self, payload: bytes) -> ImuData:
        """Decode and check a serialized message; see `StateReader.read`."""
        stamp, values = self._decode(payload)
        rate, force = values[:12], values[12:]  # three components, and nine of the covariance
        _check_measured("angular_velocity", rate[:3], rate[3:], FASTEST_IMU, "rad/s")
        _check_measured("linear_acceleration", force[:3], force[3:], HARDEST_IMU, "m/s²")
        return ImuData(stamp, rate[:3], force[:3])

    def _check_text(self, content: Any) -> None:
        if content.header.frame_id not in ("", self._frame):
            raise InputRefused(f"header.frame_id is {content.header.frame_id!r}; the IMU's frame is {self._frame!r}")


class PoseReader(StateReader):
    """Decoder of geometry_msgs/PoseWithCovarianceStamped, absolute poses of the base in the world."""

    type = "geometry_msgs/msg/PoseWithCovarianceStamped"
    paths = (*_POSE, "pose.covariance")

    def read(self, payload: bytes) -> AbsolutePose:
        """Decode and check a serialized message; see `StateReader.read`."""
        stamp, values = self._decode(payload)
        pose = finite(values[:7], "the pose")
        if not (np.abs(pose[:3]) <= FARTHEST_POSE).all():
            raise InputRefused(
                f"the position is {pose[:3].tolist()} m; at most {FARTHEST_POSE:g} m from the world's origin"
            )
        pose[3:] = unit_quaternion(pose[3:], "the orientation ")
        return AbsolutePose(stamp, pose, _checked_covariance(values[7:]))

    def _check_text(self, content: Any) -> None:
        frame = content.header.frame_id
        if frame not in POSE_FRAMES:
            raise InputRefused(
                f"header.frame_id is {frame!r}; an absolute pose is given in {', '.join(POSE_FRAMES[1:])}"
            )


class ContactForceReader(StateReader):
    """Decoder of geometry_msgs/WrenchStamped from a force sensor at a contact; its torque is not used.

    Args:
        normals: its unit normal in the axes of each frame in which the force may be given, (3,).
    """

    type = "geometry_msgs/msg/WrenchStamped"
    paths = _axes("wrench.force")

    def __init__(self, contact: str, normals: Mapping[str, Array]) -> None:
        super().__init__()
        self._contact, self._normals, self._normal = contact, normals, np.zeros(3)

    def read(self, payload: bytes) -> ContactForce:
        """Decode and check a serialized message; see `StateReader.read`."""
        stamp, force = self._decode(payload)
        finite(force, "wrench.force")
        if not (np.abs(force) <= HARDEST_CONTACT).all():
            raise InputRefused(f"wrench.force is {force.tolist()} N; at a contact it is at most {HARDEST_CONTACT:g}")
        return ContactForce(stamp, float(self._normal @ force), force)

    def _check_text(self, content: Any) -> None:
        frame = content.header.frame_id
        if frame not in self._normals:
            raise InputRefused(
                f"header.frame_id is {frame!r}; the force at contact {self._contact!r} is given in the axes of "
                f"one of {', '.join(sorted(filter(None, self._normals)))}"
            )
        self._normal = self._normals[frame]


def _check_measured(what: str, values: Array, covariance: Array, limit: float, unit: str) -> None:
    """Raise `InputRefused` if an IMU does not measure a quantity, or a value is not finite or above its limit."""
    if covariance[0] == -1.0:
        raise InputRefused(f"{what}_covariance begins with -1: the IMU does not measure it")
    finite(values, what)
    if not (np.abs(values) <= limit).all():
        raise InputRefused(f"{what} is {values.tolist()} {unit}; an IMU measures at most {limit:g}")


def _checked_covariance(rows: Array) -> Array:
    """Return the symmetric part of a covariance, (6, 6), from its rows, (36,).

    Raises:
        InputRefused: if a value is not finite, or a variance or an eigenvalue is negative or too large.
    """
    C = finite(rows, "the covariance").reshape(6, 6)
    C += C.T.copy()
    C *= 0.5
    variances = C.diagonal()
    if not (variances >= 0.0).all():
        raise InputRefused(f"the covariance has the variances {variances.tolist()}; none is negative")
    if not (variances[_USED] <= VAGUEST_POSE).all():
        raise InputRefused(
            f"the covariance has the variances {variances.tolist()}; those of position and heading are at most "
            f"{VAGUEST_POSE:g} m² and rad²"
        )
    used = C[np.ix_(_USED, _USED)]
    least = float(np.linalg.eigvalsh(used)[0])
    if not least >= _ROUNDED * float(np.trace(used)):
        raise InputRefused(f"the covariance of position and heading has the eigenvalue {least:.3g}; none is negative")
    return C
