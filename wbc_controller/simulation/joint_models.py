"""Joints of MuJoCo's model that are more than a motor: locked, passive, geared and mimic joints."""

import xml.etree.ElementTree as ET
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.robot.mimic import Followers
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.robot.passive import PassiveForces


def lock(joint: ET.Element, position: float) -> None:
    """Lock a joint of a URDF, changed in place, at a position, rad or m."""
    if position != 0.0:
        origin = joint.find("origin")
        if origin is None:
            origin = ET.SubElement(joint, "origin")
        xyz, rpy = (np.array([float(value) for value in origin.get(key, "0 0 0").split()]) for key in ("xyz", "rpy"))
        found = joint.find("axis")
        axis = np.array([float(value) for value in (found.get("xyz", "") if found is not None else "1 0 0").split()])
        along = position * axis / np.linalg.norm(axis)
        motion = (
            pin.SE3(np.eye(3), along) if joint.get("type") == "prismatic" else pin.SE3(pin.exp3(along), np.zeros(3))
        )
        placement = pin.SE3(pin.rpy.rpyToMatrix(rpy), xyz) * motion
        origin.set("xyz", " ".join(map(repr, placement.translation.tolist())))
        origin.set("rpy", " ".join(map(repr, pin.rpy.matrixToRpy(placement.rotation).tolist())))
    joint.set("type", "fixed")


def couple(spec: Any, followers: Followers, stiff: list[float], impedance: list[float]) -> None:
    """Couple mimic joints to their leaders, with MuJoCo's solref and solimp."""
    for name, mimic in followers.mimics.items():
        equality = spec.add_equality()
        equality.type = mujoco.mjtEq.mjEQ_JOINT
        equality.objtype = mujoco.mjtObj.mjOBJ_JOINT
        equality.name1, equality.name2 = name, mimic.leader
        equality.data[:5] = [mimic.offset, mimic.ratio, 0.0, 0.0, 0.0]
        equality.solref = stiff
        equality.solimp = impedance


def gear(spec: Any, model: RobotModel) -> None:
    """Add the rotors of transmissions, as fixed tendons over their joints with the rotors' inertia.

    Raises:
        ConfigurationError: if a rotor couples joints of different branches, a coupling that MuJoCo neglects.
    """
    drive = model.actuation
    for name, ratios, inertia in zip(drive.names, drive.ratios, drive.rotor_inertia.tolist(), strict=True):
        if inertia == 0.0:
            continue
        joints = [joint for joint, ratio in zip(model.joints, ratios.tolist(), strict=True) if ratio != 0.0]
        numbers = [model.pinocchio.getJointId(joint) for joint in joints]
        last = max(numbers)  # joints are numbered from the root outwards
        apart = [joint for joint, i in zip(joints, numbers, strict=True) if i not in model.pinocchio.supports[last]]
        if apart:
            raise ConfigurationError(
                f"robot.transmission.{name}.rotor_inertia = {inertia}: it couples {', '.join(apart)} with "
                f"{model.pinocchio.names[last]}, and MuJoCo knows rotors along one branch only; use 0 for the mock"
            )
        tendon = spec.add_tendon()
        tendon.name = f"{name}/rotor"
        tendon.armature = inertia
        for joint in joints:
            tendon.wrap_joint(joint, ratios[model.joints.index(joint)])


def spring(model: Any, passive: PassiveForces) -> None:
    """Add springs and dampers to the compiled model: in MuJoCo 4's specification, stiffness is a polynomial."""
    for name, given in passive.joints.items():
        joint = model.joint(name)
        model.jnt_stiffness[joint.id] = given.stiffness
        model.dof_damping[joint.dofadr[0]] = given.damping
        model.qpos_spring[joint.qposadr[0]] = given.rest
