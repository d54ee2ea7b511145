"""Construction of the robot's model."""

from wbc_controller.controller.build.robot_description import read_urdf
from wbc_controller.inverse_dynamics.robot.from_urdf import build_model
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.pinocchio_libraries import warn_of_two_installations
from wbc_controller.settings import Settings


def make_model(settings: Settings, urdf: str | None = None) -> RobotModel:
    """Build the robot's model from a URDF text, by default from ``robot.urdf``."""
    warn_of_two_installations()
    return build_model(read_urdf(settings.robot.urdf) if urdf is None else urdf, settings.robot)
