"""Robot models from URDF texts and single settings."""

from collections.abc import Iterable, Sequence
from typing import Any

from wbc_controller.inverse_dynamics.robot import from_urdf
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.settings.robot import RobotSettings

INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'


def link(name: str, *elements: tuple[str, str, str], inertial: str = INERTIAL) -> str:
    """Write a link with collision elements: position, roll, pitch and yaw, and geometry."""
    shapes = [
        f'<collision><origin xyz="{xyz}" rpy="{rpy}"/><geometry>{geometry}</geometry></collision>'
        for xyz, rpy, geometry in elements
    ]
    return f'<link name="{name}">{inertial}{"".join(shapes)}</link>'


def build_model(
    urdf: str, joints: Sequence[str], posture: Iterable[float], *, floating_base: bool = True, **settings: Any
) -> RobotModel:
    """Build a model with settings that are not validated."""
    base = "floating" if floating_base else "fixed"
    robot = RobotSettings.model_construct(joints=list(joints), posture=list(posture), base=base, **settings)
    return from_urdf.build_model(urdf, robot)
