"""Valid messages of every incoming type."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from wbc_controller.middleware.codec import message


def valid_message(type_name: str, names: Sequence[str], frame: str, stamp: int) -> Any:
    """Return a valid message."""
    content = message(type_name)
    if hasattr(content, "header"):
        content.header.stamp.sec, content.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
        content.header.frame_id = frame
    if type_name == "sensor_msgs/msg/JointState":
        content.name = list(names)
        content.position, content.velocity, content.effort = (np.zeros(len(names)) for _ in range(3))
    elif type_name == "std_msgs/msg/Float64MultiArray":
        content.data = np.zeros(len(names))
    elif type_name == "geometry_msgs/msg/Vector3Stamped":
        content.vector.z = 1.0
    elif type_name == "geometry_msgs/msg/PoseArray":
        content.poses = [message("geometry_msgs/msg/Pose")]
    elif type_name.startswith("trajectory_msgs/msg/"):
        joints = "MultiDOF" not in type_name
        content.joint_names = list(names) if joints else ["frame"]
        for second in range(1, 4):
            point = message(f"{type_name}Point")
            point.time_from_start.sec = second
            if joints:
                point.positions = np.zeros(len(names))
            else:
                point.transforms = [message("geometry_msgs/msg/Transform")]
                point.transforms[0].translation.z = 1.0
            content.points.append(point)
    return content
