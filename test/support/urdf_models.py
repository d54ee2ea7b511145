"""Robot models from URDF texts and single settings."""

from collections.abc import Iterable, Sequence
from typing import Any

from wbc_controller.inverse_dynamics.robot import from_urdf
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.settings.robot import RobotSettings


def build_model(
    urdf: str, joints: Sequence[str], posture: Iterable[float], *, floating_base: bool = True, **settings: Any
) -> RobotModel:
    """Build a model with settings that are not validated."""
    base = "floating" if floating_base else "fixed"
    robot = RobotSettings.model_construct(joints=list(joints), posture=list(posture), base=base, **settings)
    return from_urdf.build_model(urdf, robot)
