"""Valid messages of every incoming type."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

from wbc_controller.middleware.codec import TYPES, message


def valid_message(type_name: str, names: Sequence[str], frame: str, stamp: int) -> Any:
    """Return a valid message."""
    content = _blank(type_name)
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
        content.poses = [_blank("geometry_msgs/msg/Pose")]
    elif type_name.startswith("trajectory_msgs/msg/"):
        joints = "MultiDOF" not in type_name
        content.joint_names = list(names) if joints else ["frame"]
        for second in range(1, 4):
            point = _blank(f"{type_name}Point")
            point.time_from_start.sec = second
            if joints:
                point.positions = np.zeros(len(names))
            else:
                point.transforms = [_blank("geometry_msgs/msg/Transform")]
                point.transforms[0].translation.z = 1.0
            content.points.append(point)
    return content


def _blank(type_name: str) -> Any:
    values = {name: _zero(kind) for name, kind in TYPES.fielddefs[type_name][1]}
    if type_name == "geometry_msgs/msg/Quaternion":
        values["w"] = 1.0
    return message(type_name, **values)


def _zero(kind: Any) -> Any:
    node, detail = kind
    if node == Nodetype.NAME:
        return _blank(detail)
    if node == Nodetype.BASE:
        return "" if detail[0] == "string" else False if detail[0] == "bool" else 0.0 if "float" in detail[0] else 0
    element, size = detail
    if element[0] == Nodetype.BASE and element[1][0] != "string":
        return np.zeros(size, dtype=element[1][0])
    return [_zero(element) for _ in range(size)]
