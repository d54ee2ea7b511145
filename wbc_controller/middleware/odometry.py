"""Messages of the base."""

from typing import Any

import numpy as np

from wbc_controller.middleware.codec import header, message
from wbc_controller.records import Array


def odometry(
    stamp: int, frame: str, base: str, pose: Array, twist: Array, covariances: tuple[Array, Array] | None = None
) -> Any:
    """Make a nav_msgs/Odometry with a stamp in ns.

    Args:
        base: link with the axes of the twist.
        pose: position in m and quaternion x, y, z, w, (7,).
        twist: linear, then angular, (6,) in m/s and rad/s.
        covariances: of position and rotations about the axes of `frame`, and of the twist, (6, 6); None for zeros.
    """
    of_pose, of_twist = covariances if covariances is not None else (np.zeros(36), np.zeros(36))
    return message(
        "nav_msgs/msg/Odometry",
        header=header(stamp, frame),
        child_frame_id=base,
        pose={"pose": _pose(pose), "covariance": of_pose.ravel()},
        twist={"twist": {"linear": twist[:3], "angular": twist[3:]}, "covariance": of_twist.ravel()},
    )


def pose_with_covariance(stamp: int, frame: str, pose: Array, position: float, turn: float) -> Any:
    """Make a PoseWithCovarianceStamped from standard deviations of position, m, and rotation, rad."""
    covariance = np.diag([position**2] * 3 + [turn**2] * 3)
    return message(
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        header=header(stamp, frame),
        pose={"pose": _pose(pose), "covariance": covariance.ravel()},
    )


def transform(stamp: int, frame: str, base: str, pose: Array) -> Any:
    """Make a tf2_msgs/TFMessage from a frame to the base's pose, (7,)."""
    content = message(
        "geometry_msgs/msg/TransformStamped",
        header=header(stamp, frame),
        child_frame_id=base,
        transform={"translation": pose[:3], "rotation": pose[3:]},
    )
    return message("tf2_msgs/msg/TFMessage", transforms=[content])


def _pose(pose: Array) -> dict[str, Array]:
    return {"position": pose[:3], "orientation": pose[3:]}
