"""The robot's model: a URDF with a floating or fixed base, and which joints are actuated in which order."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from wbc_controller.errors import ConfigurationError, valid_choices
from wbc_controller.records import Array, frozen


@dataclass(frozen=True)
class RobotModel:
    """A robot's model, ready for the controller.

    Attributes:
        pinocchio: the rigid-body model; joints that are not actuated are locked.
        urdf: the URDF's text.
        joints: names of the actuated joints, in the order of the command.
        floating_base: whether the root link moves freely.
        q_index: index in q of each actuated joint, (na,).
        v_index: index in v of each actuated joint, (na,).
        effort_limits: largest torque of each joint, (na,) in N·m.
        velocity_limits: largest speed of each joint, (na,) in rad/s.
        position_lower: lower position limits, (na,) in rad.
        position_upper: upper position limits, (na,) in rad.
        posture: nominal joint positions, (na,) in rad.
    """

    pinocchio: pin.Model
    urdf: str
    joints: tuple[str, ...]
    floating_base: bool
    q_index: np.ndarray
    v_index: np.ndarray
    effort_limits: Array
    velocity_limits: Array
    position_lower: Array
    position_upper: Array
    posture: Array

    @property
    def nq(self) -> int:
        """Dimension of the configuration."""
        return int(self.pinocchio.nq)

    @property
    def nv(self) -> int:
        """Dimension of the generalized velocity."""
        return int(self.pinocchio.nv)

    @property
    def na(self) -> int:
        """Number of actuated joints."""
        return len(self.joints)

    @property
    def base_link(self) -> str:
        """Name of the root link."""
        return root_link(self.pinocchio)

    @property
    def name(self) -> str:
        """Name of the robot in its URDF."""
        return str(self.pinocchio.name)

    @property
    def mass(self) -> float:
        """Total mass, kg."""
        return float(pin.computeTotalMass(self.pinocchio))

    @property
    def gravity(self) -> float:
        """Magnitude of gravity, m/s²."""
        return float(np.linalg.norm(self.pinocchio.gravity.linear))

    def frame_id(self, name: str, key: str) -> int:
        """Look up a frame.

        Args:
            name: name of a link or joint of the URDF.
            key: the configuration key that names it, for the error.

        Raises:
            ConfigurationError: where the model has no such frame.
        """
        if not self.pinocchio.existFrame(name):
            links = [frame.name for frame in self.pinocchio.frames if frame.type == pin.BODY]
            raise ConfigurationError(f"{key} = {name!r}: the robot has no such frame; {valid_choices(name, links)}")
        return int(self.pinocchio.getFrameId(name))

    def joint_columns(self, names: Sequence[str], key: str) -> np.ndarray:
        """Give the position of each named joint in the command, (k,); no names means all joints.

        Raises:
            ConfigurationError: where a joint is not actuated.
        """
        for name in names:
            if name not in self.joints:
                raise ConfigurationError(
                    f"{key}: {name!r} is not an actuated joint; {valid_choices(name, self.joints)}"
                )
        return np.array([self.joints.index(name) for name in names or self.joints], dtype=np.intp)

    def configuration(self, joint_positions: Array, base: pin.SE3 | None = None) -> Array:
        """Assemble q from joint positions in the order of the command, (na,), and the base's placement."""
        q = np.array(pin.neutral(self.pinocchio))
        if self.floating_base and base is not None:
            q[:7] = pin.SE3ToXYZQUAT(base)
        q[self.q_index] = joint_positions
        return q


def root_link(model: pin.Model) -> str:
    """Name the link that the base joint carries, or that is fixed to the world."""
    wanted = 1 if model.njoints > 1 and model.joints[1].nq == 7 else 0
    for frame in model.frames:
        if frame.type == pin.BODY and frame.parentJoint == wanted and frame.name != "universe":
            return str(frame.name)
    return "universe"


def build_model(
    urdf: str,
    joints: Sequence[str],
    posture: Iterable[float],
    *,
    floating_base: bool = True,
    armature: float = 0.0,
    effort_limit_scale: float = 1.0,
) -> RobotModel:
    """Build the model of a robot from its URDF.

    Args:
        urdf: the URDF's text.
        joints: actuated joints with one degree of freedom, in the order of the command; all others are locked at zero.
        posture: nominal position of each joint, rad.
        floating_base: whether the root link moves freely.
        armature: reflected rotor inertia of every joint, kg·m².
        effort_limit_scale: share of the URDF's effort limits that may be used.

    Raises:
        ConfigurationError: where the URDF or a joint cannot be used.
    """
    try:
        full = pin.buildModelFromXML(urdf, *([pin.JointModelFreeFlyer()] if floating_base else []))
    except (ValueError, RuntimeError) as error:
        raise ConfigurationError(f"robot.urdf: not a usable URDF: {error}") from error
    own = [name for name in full.names[1:] if name != "root_joint"]
    for name in joints:
        if name not in own:
            raise ConfigurationError(f"robot.joints: {name!r} is not a joint of the URDF; {valid_choices(name, own)}")
        joint = full.joints[full.getJointId(name)]
        if joint.nv != 1 or joint.nq != 1:
            raise ConfigurationError(
                f"robot.joints: {name!r} has {joint.nv} degrees of freedom in {joint.nq} coordinates; "
                "one revolute or prismatic joint with limits is needed"
            )
    locked = [full.getJointId(name) for name in own if name not in joints]
    model = pin.buildReducedModel(full, locked, pin.neutral(full)) if locked else full
    ids = [model.getJointId(name) for name in joints]
    v_index = np.array([model.joints[i].idx_v for i in ids], dtype=np.intp)
    q_index = np.array([model.joints[i].idx_q for i in ids], dtype=np.intp)
    joint_armature = np.array(model.armature)
    joint_armature[v_index] = armature
    model.armature = joint_armature
    effort_limits = effort_limit_scale * np.array(model.upperEffortLimit)[v_index]
    _require_limits(joints, effort_limits, "effort")
    velocity_limits = np.array(model.upperVelocityLimit)[v_index]
    _require_limits(joints, velocity_limits, "velocity")
    result = RobotModel(
        pinocchio=model,
        urdf=urdf,
        joints=tuple(joints),
        floating_base=floating_base,
        q_index=q_index,
        v_index=v_index,
        effort_limits=frozen(effort_limits),
        velocity_limits=frozen(velocity_limits),
        position_lower=frozen(np.array(model.lowerPositionLimit)[q_index]),
        position_upper=frozen(np.array(model.upperPositionLimit)[q_index]),
        posture=frozen(list(posture)),
    )
    for name, value, low, high in zip(
        joints, result.posture, result.position_lower, result.position_upper, strict=True
    ):
        if not (low <= value <= high):
            raise ConfigurationError(
                f"robot.posture: {value} rad for {name!r} is outside its limits [{low}, {high}] rad"
            )
    return result


def _require_limits(joints: Sequence[str], limits: np.ndarray, kind: str) -> None:
    for name, limit in zip(joints, limits, strict=True):
        if not (0.0 < limit < np.inf):
            raise ConfigurationError(f"robot.urdf: joint {name!r} has the {kind} limit {limit}; it must be positive")
