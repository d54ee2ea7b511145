"""Actuators and inertias, without Pinocchio."""

from dataclasses import dataclass

import numpy as np

from wbc_controller.errors import ConfigurationError, require_known
from wbc_controller.inverse_dynamics.robot.transmission import Drive, make_drive
from wbc_controller.inverse_dynamics.robot.urdf import LARGEST_URDF, read_robot
from wbc_controller.inverse_dynamics.robot.urdf import inertia_tensor as inertia_tensor
from wbc_controller.inverse_dynamics.robot.urdf_structure import vector_of
from wbc_controller.records import Array, frozen
from wbc_controller.settings.resources import locate, read_text
from wbc_controller.settings.robot import RobotSettings


def read_urdf(urdf: str) -> str:
    """Read the file ``robot.urdf``."""
    if not urdf:
        raise ConfigurationError(
            "robot.urdf is empty and no URDF arrived on the topic robot_description; name a file, or publish it latched"
        )
    return read_text(locate(urdf), f"robot.urdf = {urdf!r}", LARGEST_URDF)


@dataclass(frozen=True, slots=True)
class Description:
    """Actuators of a robot."""

    name: str
    drive: Drive
    effort_limits: Array  # usable torque of each actuator, (na,) in N·m


def describe(urdf: str, robot: RobotSettings) -> Description:
    """Read the actuators from a URDF text."""
    tree, _ = read_robot(urdf, robot.joint_limits)
    limits = {str(joint.get("name")): joint.find("limit") for joint in tree.findall("joint")}
    require_known(robot.joints, limits, "robot.joints:", " is not a joint of the URDF")
    drive = make_drive(robot, np.array([vector_of(limits[name], "effort", "nan")[0] for name in robot.joints]))
    return Description(tree.get("name", ""), drive, frozen(robot.effort_limit_scale * drive.effort_limits))


def are_possible_moments(moments: Array) -> bool:
    """Return True if principal moments, (3,), rising, satisfy the triangle inequality."""
    return bool(moments[2] <= (moments[0] + moments[1]) * (1.0 + 1.0e-9))
