"""Writes references as the messages in which setpoints are given: the reverse of reading them in `decoding`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from wbc_controller.records import Array
from wbc_controller.wire.messages import header, message

#: Kinds of task whose references are given by joint name, and the field of the JointState that holds them.
JOINT_FIELDS = {"posture": "position", "torque": "effort"}


def setpoint_message(
    type_name: str, kind: str, position: Array, *, frame: str = "world", stamp: int = 0, joints: Sequence[str] = ()
) -> Any:
    """Make the message of a task's setpoint.

    Args:
        type_name: its type, one of `TASK_TYPES`.
        kind: kind of the task.
        position: in the form of the task's references; coordinates that the form lacks are 0 in the message.
        frame: for its header.
        stamp: for its header, ns.
        joints: names of the values, where the task is about joints.
    """
    values = np.asarray(position, dtype=np.float64)
    top = header(stamp, frame)
    if kind in JOINT_FIELDS:
        fields = dict.fromkeys(("position", "velocity", "effort"), np.zeros(0)) | {JOINT_FIELDS[kind]: values}
        return message(type_name, header=top, name=list(joints), **fields)
    if type_name == "geometry_msgs/msg/PoseStamped":
        at, turn = (values[:-4], values[-4:])
        x, y, z, w = (float(value) for value in turn)
        orientation = message("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
        pose = message("geometry_msgs/msg/Pose", position=_xyz("Point", at), orientation=orientation)
        return message(type_name, header=top, pose=pose)
    if type_name == "geometry_msgs/msg/WrenchStamped":
        return wrench_stamped(values, frame, stamp)
    if type_name == "geometry_msgs/msg/PointStamped":
        return message(type_name, header=top, point=_xyz("Point", values))
    return message(type_name, header=top, vector=_xyz("Vector3", values))


def wrench_stamped(wrench: Array, frame: str, stamp: int = 0) -> Any:
    """Make a geometry_msgs/WrenchStamped from a wrench, (6,) in N and N·m."""
    parts = message("geometry_msgs/msg/Wrench", force=vector(wrench[:3]), torque=vector(wrench[3:]))
    return message("geometry_msgs/msg/WrenchStamped", header=header(stamp, frame), wrench=parts)


def vector(values: Array) -> Any:
    """Make a geometry_msgs/Vector3."""
    return _xyz("Vector3", values)


def _xyz(kind: str, values: Array) -> Any:
    x, y, z = (float(value) for value in [*values, 0.0, 0.0, 0.0][:3])
    return message(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)
