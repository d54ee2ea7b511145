"""Setpoint messages: the inverse of `decoding`."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from wbc_controller.middleware.codec import header, message, time_fields
from wbc_controller.records import Array

#: Field of the JointState, by kind of task with references by joint name.
JOINT_FIELDS = {"posture": "position", "torque": "effort"}
#: Numeric fields of a geometry_msgs/WrenchStamped.
WRENCH = tuple(f"wrench.{part}.{axis}" for part in ("force", "torque") for axis in "xyz")


def setpoint_message(
    type_name: str, kind: str, position: Array, *, frame: str = "world", stamp: int = 0, joints: Sequence[str] = ()
) -> Any:
    """Make the message of a task's setpoint, of a type in `TASK_TYPES`.

    The position has the task's reference form; missing coordinates become 0. A joint task needs its joints.
    """
    values, top = np.asarray(position, dtype=np.float64), header(stamp, frame)
    if kind in JOINT_FIELDS:
        return message(type_name, header=top, name=list(joints), **{JOINT_FIELDS[kind]: values})
    if type_name == "geometry_msgs/msg/PoseStamped":
        return message(type_name, header=top, pose={"position": values[:-4], "orientation": values[-4:]})
    if type_name == "geometry_msgs/msg/WrenchStamped":
        return wrench_stamped(values, frame, stamp)
    return message(type_name, header=top, **{"point" if type_name.endswith("/PointStamped") else "vector": values})


def wrench_stamped(wrench: Array, frame: str, stamp: int = 0) -> Any:
    """Make a geometry_msgs/WrenchStamped from a wrench, (6,), or a force, (3,); N, N·m."""
    parts = {"force": wrench[:3], "torque": wrench[3:]}
    return message("geometry_msgs/msg/WrenchStamped", header=header(stamp, frame), wrench=parts)


def velocity_message(velocity: Sequence[float] | Array) -> Any:
    """Make a geometry_msgs/Twist, m/s and rad/s."""
    forward, left, turning = map(float, velocity)
    return message("geometry_msgs/msg/Twist", linear={"x": forward, "y": left}, angular={"z": turning})


def com_trajectory(times: Sequence[float], positions: Array, *, task: str = "com", stamp: int = 0) -> Any:
    """Make a trajectory of the centre of mass through points, (n, 3) in m; stamp of its start in ns, 0 for now."""
    points = [{"transforms": [message("geometry_msgs/msg/Transform", translation=position)]} for position in positions]
    return trajectory_message("MultiDOFJointTrajectory", [task], times, points, stamp)


def joint_trajectory(joints: Sequence[str], times: Sequence[float], positions: Array) -> Any:
    """Make an immediate joint trajectory, (n, k) in rad."""
    return trajectory_message("JointTrajectory", joints, times, [{"positions": position} for position in positions])


def trajectory_message(
    kind: str, names: Sequence[str], times: Sequence[float], points: Sequence[dict[str, Any]], stamp: int = 0
) -> Any:
    """Make a JointTrajectory or a MultiDOFJointTrajectory from the fields of its points."""
    made = [
        message(f"trajectory_msgs/msg/{kind}Point", **point, time_from_start=time_fields(round(1e9 * time)))
        for time, point in zip(times, points, strict=True)
    ]
    kind = f"trajectory_msgs/msg/{kind}"
    return message(kind, header=header(stamp, "world"), joint_names=list(names), points=made)
