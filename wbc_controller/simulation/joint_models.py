"""Passive, geared and mimic joints in MuJoCo."""

from typing import Any

import mujoco

from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.robot.mimic import Followers
from wbc_controller.inverse_dynamics.robot.model import PassiveForces, RobotModel


def add_mimic_joints(spec: Any, followers: Followers) -> None:
    """Couple mimic joints to their leaders."""
    for name, mimic in followers.mimics.items():
        equality = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, objtype=mujoco.mjtObj.mjOBJ_JOINT)
        equality.name1, equality.name2 = name, mimic.leader
        equality.data[:5] = [mimic.offset, mimic.ratio, 0.0, 0.0, 0.0]


def add_rotors(spec: Any, model: RobotModel) -> None:
    """Add the rotors of transmissions as fixed tendons with inertia; MuJoCo requires joints of one branch."""
    drive = model.actuation
    for name, ratios, inertia in zip(drive.names, drive.ratios, drive.rotor_inertia.tolist(), strict=True):
        if inertia == 0.0:
            continue
        driven = {joint: ratio for joint, ratio in zip(model.joints, ratios.tolist(), strict=True) if ratio != 0.0}
        last = max(model.pinocchio.getJointId(joint) for joint in driven)
        apart = [joint for joint in driven if model.pinocchio.getJointId(joint) not in model.pinocchio.supports[last]]
        if apart:
            raise ConfigurationError(
                f"robot.transmission.{name}.rotor_inertia = {inertia}: it couples {', '.join(apart)} with "
                f"{model.pinocchio.names[last]} on another branch, which MuJoCo does not support; use 0 for the mock"
            )
        tendon = spec.add_tendon(name=f"{name}/rotor", armature=inertia)
        for joint, ratio in driven.items():
            tendon.wrap_joint(joint, ratio)


def add_springs(model: Any, passive: PassiveForces) -> None:
    """Add springs and dampers to the compiled model; MuJoCo 4's specification has polynomial stiffness."""
    for name, given in passive.joints.items():
        joint = model.joint(name)
        model.jnt_stiffness[joint.id] = given.stiffness
        model.dof_damping[joint.dofadr[0]] = given.damping
        model.qpos_spring[joint.qposadr[0]] = given.rest
