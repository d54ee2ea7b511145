"""Construction of the robot's model."""

from wbc_controller.controller.build.robot_description import joint_limits, read_urdf, transmissions
from wbc_controller.inverse_dynamics.robot.from_urdf import build_model
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.robot.passive import PassiveJoint
from wbc_controller.pinocchio_libraries import warn_of_two_installations
from wbc_controller.settings import Settings


def make_model(settings: Settings, urdf: str | None = None) -> RobotModel:
    """Build the robot's model from a URDF text, by default from ``robot.urdf``."""
    warn_of_two_installations()
    robot = settings.robot
    return build_model(
        read_urdf(robot.urdf) if urdf is None else urdf,
        robot.joints,
        robot.posture,
        floating_base=robot.base == "floating",
        armature=robot.armature,
        effort_limit_scale=robot.effort_limit_scale,
        actuators=robot.actuators,
        transmission=transmissions(robot),
        passive_joints={
            name: PassiveJoint(joint.stiffness, joint.damping, joint.rest)
            for name, joint in robot.passive_joints.items()
        },
        locked_joints=robot.locked_joints,
        joint_limits=joint_limits(robot),
        commanded_by_joint=robot.command == "joints",
    )
