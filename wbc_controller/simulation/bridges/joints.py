"""States by joint name."""

import reprlib
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from wbc_controller.arguments import finite, is_mapping_of_names, number, sized
from wbc_controller.errors import InputRefused, valid_choices
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.tasks.form import unit_quaternion
from wbc_controller.records import Array


def state_from_joints(
    model: RobotModel,
    positions: Mapping[str, float],
    velocities: Mapping[str, float] | None = None,
    *,
    base_position: npt.ArrayLike = (0.0, 0.0, 0.0),
    base_quaternion: npt.ArrayLike = (0.0, 0.0, 0.0, 1.0),
    base_linear_velocity: npt.ArrayLike = (0.0, 0.0, 0.0),
    base_angular_velocity: npt.ArrayLike = (0.0, 0.0, 0.0),
) -> tuple[Array, Array]:
    """Return Pinocchio's q, (nq,), and v, (nv,), from joints by name and the pose and twist of a floating base.

    Args:
        positions: of every joint in ``robot.joints``, rad (m).
        velocities: rad/s (m/s).
        base_position: in the world, m.
        base_quaternion: in the world, (x, y, z, w).
        base_linear_velocity: in base axes, m/s.
        base_angular_velocity: in base axes, rad/s.
    """
    if not isinstance(model, RobotModel):
        raise InputRefused(f"model is {reprlib.repr(model)}; it must be a RobotModel, such as controller.model")
    rates = dict.fromkeys(model.joints, 0.0) if velocities is None else velocities
    pose = np.concatenate([_three(base_position, "base_position"), np.zeros(4)])
    pose[3:] = unit_quaternion(
        finite(sized(base_quaternion, 4, "base_quaternion"), "base_quaternion"), "base_quaternion "
    )
    twist = np.concatenate(
        [_three(base_linear_velocity, "base_linear_velocity"), _three(base_angular_velocity, "base_angular_velocity")]
    )
    joints = (_by_name(model, positions, "positions"), _by_name(model, rates, "velocities"))
    return model.state(*joints, pose, twist) if model.floating_base else model.state(*joints)


def _by_name(model: RobotModel, values: Mapping[str, float], what: str) -> Array:
    if not is_mapping_of_names(values):
        raise InputRefused(f"{what} is {reprlib.repr(values)}; it must be a dictionary of numbers by joint")
    missing = [name for name in model.joints if name not in values]
    if missing:
        raise InputRefused(
            f"{what}: {len(missing)} of {model.nj} joints are missing: {', '.join(missing)}; "
            f"{valid_choices(missing[0], values)}"
        )
    return np.array([number(values[name], f"{what}: {name!r}") for name in model.joints])


def _three(values: npt.ArrayLike, what: str) -> Array:
    return finite(sized(values, 3, what), what)
