"""States and torques in other conventions: by joint name, and of your own MuJoCo model."""

import reprlib
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from wbc_controller.arguments import finite, number, sized, unit_quaternion
from wbc_controller.errors import ConfigurationError, InputRefused, require_known, valid_choices
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.robot.orientation import rotation_of
from wbc_controller.records import Array

_FREE = 0  # ``mjtJoint.mjJNT_FREE``


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
    position = _vector(base_position, 3, "base_position")
    quaternion = unit_quaternion(_vector(base_quaternion, 4, "base_quaternion"), "base_quaternion ")
    linear = _vector(base_linear_velocity, 3, "base_linear_velocity")
    angular = _vector(base_angular_velocity, 3, "base_angular_velocity")
    joints = (_by_name(model, positions, "positions"), _by_name(model, rates, "velocities"))
    base = (np.concatenate([position, quaternion]), np.concatenate([linear, angular]))
    return model.state(*joints, *(base if model.floating_base else ()))


class MujocoInterface:
    """Reads a robot's state from MuJoCo's ``qpos, qvel``, and writes its torques as generalized forces.

    Joints are found by name. Quaternions are converted from (w, x, y, z) to (x, y, z, w), and the base's linear
    velocity from world to base axes. The base body must have the frame of the URDF's root link.
    """

    def __init__(self, model: RobotModel, mujoco_model: Any) -> None:
        if not isinstance(model, RobotModel) or not hasattr(mujoco_model, "jnt_qposadr"):
            raise ConfigurationError(
                "expected a RobotModel, such as controller.model, and a mujoco.MjModel, "
                f"not {type(model).__name__} and {type(mujoco_model).__name__}"
            )
        self._model = model
        names = [mujoco_model.joint(i).name for i in range(mujoco_model.njnt)]
        require_known(model.joints, names, "the MuJoCo model has no joint")
        numbers = [names.index(name) for name in model.joints]
        self._qpos = np.array(mujoco_model.jnt_qposadr)[numbers]
        self._dof = np.array(mujoco_model.jnt_dofadr)[numbers]
        if model.floating_base:
            body = int(mujoco_model.jnt_bodyid[numbers[0]])
            root = int(mujoco_model.body_rootid[body])
            first = int(mujoco_model.body_jntadr[root])
            if first < 0 or mujoco_model.jnt_type[first] != _FREE:
                raise ConfigurationError(
                    f"the base is floating, and the MuJoCo body {mujoco_model.body(root).name!r} has no free joint; "
                    "give it one, or set robot.base: fixed"
                )
            self._base_qpos = int(mujoco_model.jnt_qposadr[first])
            self._base_dof = int(mujoco_model.jnt_dofadr[first])

    def state(self, data: Any) -> tuple[Array, Array]:
        """Return Pinocchio's q, (nq,), and v, (nv,), from an ``mujoco.MjData``."""
        model = self._model
        joints = data.qpos[self._qpos], data.qvel[self._dof]
        if not model.floating_base:
            return model.state(*joints)
        pose = data.qpos[self._base_qpos : self._base_qpos + 7][[0, 1, 2, 4, 5, 6, 3]]
        twist = np.array(data.qvel[self._base_dof : self._base_dof + 6])
        twist[:3] = rotation_of(pose[3:]).T @ twist[:3]
        return model.state(*joints, pose, twist)

    def place(self, data: Any, q: Array, v: Array | None = None) -> None:
        """Write q, (nq,), and v, (nv,), into an ``mujoco.MjData``."""
        model = self._model
        q = _vector(q, model.nq, "q")
        v = np.zeros(model.nv) if v is None else _vector(v, model.nv, "v")
        data.qpos[self._qpos], data.qvel[self._dof] = q[model.q_index], v[model.v_index]
        if model.floating_base:
            data.qpos[self._base_qpos : self._base_qpos + 7] = q[[0, 1, 2, 6, 3, 4, 5]]
            rotation = rotation_of(q[3:7])
            data.qvel[self._base_dof : self._base_dof + 6] = np.concatenate([rotation @ v[:3], v[3:6]])

    def apply(self, data: Any, tau: Array) -> None:
        """Write torques of the actuators, (na,) in N·m, into ``data.qfrc_applied``; ``data.ctrl`` is unchanged."""
        tau = _vector(tau, self._model.na, "tau")
        data.qfrc_applied[self._dof] = self._model.actuation.at_joints(tau)


def _by_name(model: RobotModel, values: Mapping[str, float], what: str) -> Array:
    if not isinstance(values, Mapping) or not all(isinstance(name, str) for name in values):
        raise InputRefused(f"{what} is {reprlib.repr(values)}; it must be a dictionary of numbers by joint")
    missing = [name for name in model.joints if name not in values]
    if missing:
        raise InputRefused(
            f"{what}: {len(missing)} of {model.nj} joints are missing: {', '.join(missing)}; "
            f"{valid_choices(missing[0], values)}"
        )
    return np.array([number(values[name], f"{what}: {name!r}") for name in model.joints])


def _vector(values: npt.ArrayLike, size: int, what: str) -> Array:
    return finite(sized(values, size, what), what)
