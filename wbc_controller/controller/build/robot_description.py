"""Reads actuators and inertias from the URDF's text and the settings, without Pinocchio."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from wbc_controller.errors import ConfigurationError, valid_choices
from wbc_controller.inverse_dynamics.robot.transmission import Drive, Transmission, make_drive
from wbc_controller.inverse_dynamics.robot.urdf import LARGEST_URDF, JointLimits, read_robot
from wbc_controller.inverse_dynamics.robot.urdf import inertia_tensor as inertia_tensor
from wbc_controller.records import Array, frozen
from wbc_controller.settings import RobotSettings
from wbc_controller.settings.resources import locate, read_text

_log = logging.getLogger(__name__)


def read_urdf(urdf: str) -> str:
    """Read the URDF that ``robot.urdf`` names.

    Raises:
        ConfigurationError: if no file is named, or it cannot be read.
    """
    if not urdf:
        raise ConfigurationError(
            "robot.urdf is empty and no URDF came on the topic robot_description; name a file, or publish it latched"
        )
    return read_text(locate(urdf), f"robot.urdf = {urdf!r}", LARGEST_URDF)


@dataclass(frozen=True, slots=True)
class Description:
    """A robot's actuators, as described by the URDF and the settings.

    Attributes:
        name: name of the robot.
        drive: the actuators.
        effort_limits: largest torque of each actuator that may be used, (na,) in N·m.
    """

    name: str
    drive: Drive
    effort_limits: Array


def transmissions(robot: RobotSettings) -> dict[str, Transmission]:
    """A robot's actuators other than the motors of single joints, by name."""
    return {
        name: Transmission(given.ratios, given.effort_limit, given.rotor_inertia)
        for name, given in robot.transmission.items()
    }


def joint_limits(robot: RobotSettings) -> dict[str, JointLimits]:
    """Limits of a robot's joints that replace those of the URDF, by joint."""
    return {
        name: JointLimits(given.effort, given.velocity, given.lower, given.upper)
        for name, given in robot.joint_limits.items()
    }


def describe(urdf: str, robot: RobotSettings) -> Description:
    """Read a robot's actuators from a URDF's text.

    Raises:
        ConfigurationError: if the text is no URDF, a joint or its limit is missing, or the actuators cannot be used.
    """
    tree, _ = read_robot(urdf, joint_limits(robot))
    limits = {str(joint.get("name")): joint.find("limit") for joint in tree.findall("joint")}
    efforts = []
    for name in robot.joints:
        if name not in limits:
            raise ConfigurationError(
                f"robot.joints: {name!r} is not a joint of the URDF; {valid_choices(name, limits)}"
            )
        limit = limits[name]
        try:
            efforts.append(float("" if limit is None else limit.get("effort", "")))
        except ValueError:
            efforts.append(math.nan)
    drive = make_drive(
        robot.joints,
        np.array(efforts),
        actuators=robot.actuators,
        transmission=transmissions(robot),
        passive=robot.passive_joints,
        by_joint=robot.command == "joints",
    )
    return Description(tree.get("name", ""), drive, frozen(robot.effort_limit_scale * drive.effort_limits))


def are_possible_moments(moments: Array) -> bool:
    """Whether principal moments of inertia, (3,) in rising order, are possible: none exceeds the sum of the others."""
    return bool(moments[2] <= (moments[0] + moments[1]) * (1.0 + 1.0e-9))


def impossible_inertias(urdf: str) -> list[str]:
    """Names of the links with a physically impossible inertia; Pinocchio does not check it, and MuJoCo refuses it."""
    links = ElementTree.fromstring(urdf).findall("link")  # noqa: S314 - checked when the model was made
    names = []
    for link in links:
        inertia = link.find("inertial/inertia")
        if inertia is not None:
            moments: Array = np.asarray(np.linalg.eigvalsh(inertia_tensor(inertia)), dtype=np.float64)
            if not are_possible_moments(moments):
                names.append(str(link.get("name")))
    return names
