"""The robot's model: a URDF with a floating or fixed base, which of its joints move, and what drives them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType

import numpy as np
import pinocchio as pin

from wbc_controller.core.actuation import Actuation
from wbc_controller.core.mimic import Followers, Mimic, read_mimics
from wbc_controller.core.passive import PassiveForces, PassiveJoint
from wbc_controller.core.places import as_slice
from wbc_controller.core.transmission import Transmission, make_drive
from wbc_controller.errors import ConfigurationError, valid_choices
from wbc_controller.records import Array, frozen


@dataclass(frozen=True)
class RobotModel:
    """A robot's model, ready for the controller.

    Attributes:
        pinocchio: the rigid-body model; joints that do not move are locked.
        urdf: the URDF's text.
        joints: names of the joints that move and are measured, (nj,).
        floating_base: whether the root link moves freely.
        q_index: index in q of each joint, (nj,).
        v_index: index in v of each joint, (nj,).
        velocity_limits: largest speed of each joint, (nj,) in rad/s.
        position_lower: lower position limits, (nj,) in rad.
        position_upper: upper position limits, (nj,) in rad.
        posture: nominal joint positions, (nj,) in rad.
        actuation: what drives the joints; its actuators are in the order of the command.
        effort_limits: largest torque of each actuator that may be used, (na,) in N·m.
        passive: the springs and dampers of the joints without a motor of their own; None where there is none.
        followers: the joints that follow others; None where none does.
        locked: position of each joint that is locked elsewhere than at zero, rad.
    """

    pinocchio: pin.Model
    urdf: str
    joints: tuple[str, ...]
    floating_base: bool
    q_index: np.ndarray
    v_index: np.ndarray
    velocity_limits: Array
    position_lower: Array
    position_upper: Array
    posture: Array
    actuation: Actuation
    effort_limits: Array
    passive: PassiveForces | None = None
    followers: Followers | None = None
    locked: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))

    @cached_property
    def nq(self) -> int:
        """Dimension of the configuration."""
        return int(self.pinocchio.nq)

    @cached_property
    def nv(self) -> int:
        """Dimension of the generalized velocity."""
        return int(self.pinocchio.nv)

    @property
    def nj(self) -> int:
        """Number of joints that move and are measured."""
        return len(self.joints)

    @cached_property
    def q_places(self) -> np.ndarray | slice:
        """`q_index`, as a slice where that is one."""
        return as_slice(self.q_index)

    @cached_property
    def v_places(self) -> np.ndarray | slice:
        """`v_index`, as a slice where that is one."""
        return as_slice(self.v_index)

    @cached_property
    def na(self) -> int:
        """Number of actuators."""
        return len(self.actuation.names)

    @property
    def actuators(self) -> tuple[str, ...]:
        """Names of the actuators, in the order of the command."""
        return self.actuation.names

    @property
    def driven_joints(self) -> tuple[str, ...]:
        """Names of the joints that an actuator drives."""
        return tuple(name for name, driven in zip(self.joints, self.actuation.driven, strict=True) if driven)

    @property
    def moving_joints(self) -> tuple[str, ...]:
        """Names of all joints that move, those that follow others among them."""
        return self.joints + (self.followers.names if self.followers is not None else ())

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
        """Give the place of each named joint in `joints`, (k,); no names means all joints.

        Raises:
            ConfigurationError: where a joint is not one of them.
        """
        for name in names:
            if name not in self.joints:
                raise ConfigurationError(
                    f"{key}: {name!r} is not one of robot.joints; {valid_choices(name, self.joints)}"
                )
        return np.array([self.joints.index(name) for name in names or self.joints], dtype=np.intp)

    def configuration(self, joint_positions: Array, base: pin.SE3 | None = None) -> Array:
        """Assemble q from the positions of the joints, (nj,), and the base's placement."""
        q = np.array(pin.neutral(self.pinocchio))
        if self.floating_base and base is not None:
            q[:7] = pin.SE3ToXYZQUAT(base)
        q[self.q_index] = joint_positions
        if self.followers is not None:
            self.followers.place(q)
        return q

    def state(
        self,
        joint_positions: Array,
        joint_velocities: Array,
        pose: Array | None = None,
        twist: Array | None = None,
    ) -> tuple[Array, Array]:
        """Assemble q and v from what is measured.

        Args:
            joint_positions: (nj,) in rad.
            joint_velocities: (nj,) in rad/s.
            pose: position and quaternion of a floating base, (7,).
            twist: its velocity in its own axes, (6,).
        """
        q, v = np.zeros(self.nq), np.zeros(self.nv)
        if pose is not None and twist is not None:
            q[:7], v[:6] = pose, twist
        q[self.q_index] = joint_positions
        v[self.v_index] = joint_velocities
        if self.followers is not None:
            self.followers.place(q)
            self.followers.move(v)
        return q, v

    def passive_force(self, q: Array, v: Array) -> Array:
        """Generalized force of the springs and dampers of passive joints at a state, (nv,)."""
        force = np.zeros(self.nv)
        if self.passive is not None:
            force[self.passive.v_index] = self.passive.torques(q, v)
        return force

    def joint_forces(self, force: Array) -> Array:
        """A generalized force, (nv,), at the joints, (nj,); that on followers acts on the joints that they follow."""
        if self.followers is not None:
            force = np.array(force)
            self.followers.carry(force)
        return np.asarray(force[self.v_index])


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
    actuators: Sequence[str] = (),
    transmission: Mapping[str, Transmission] | None = None,
    passive_joints: Mapping[str, PassiveJoint] | None = None,
    locked_joints: Mapping[str, float] | None = None,
    commanded_by_joint: bool = False,
) -> RobotModel:
    """Build the model of a robot from its URDF.

    Joints that the URDF lets follow others (``<mimic>``) do so. All other joints are locked.

    Args:
        urdf: the URDF's text.
        joints: joints with one degree of freedom that move and are measured.
        posture: nominal position of each joint, rad.
        floating_base: whether the root link moves freely.
        armature: reflected rotor inertia of every joint that has a motor of its own, kg·m².
        effort_limit_scale: share of the effort limits that may be used.
        actuators: names of the actuators in the order of the command: of joints with a motor of their own, and of
            transmissions. Empty for one motor at each joint that is not passive.
        transmission: actuators with ratios, by name.
        passive_joints: those of the joints that have no motor of their own.
        locked_joints: position of joints that are locked, rad; all others that do not move are locked at zero.
        commanded_by_joint: whether the robot is commanded by torques at its driven joints, instead of those of its
            actuators.

    Raises:
        ConfigurationError: where the URDF or a joint cannot be used.
    """
    try:
        full = pin.buildModelFromXML(urdf, *([pin.JointModelFreeFlyer()] if floating_base else []))
    except (ValueError, RuntimeError) as error:
        raise ConfigurationError(f"robot.urdf: not a usable URDF: {error}") from error
    mimics, passive_joints, locked_joints = read_mimics(urdf), passive_joints or {}, dict(locked_joints or {})
    own = [name for name in full.names[1:] if name != "root_joint"]
    for name in joints:
        _require_own_coordinate(full, name, "robot.joints", own, mimics)
    for name in passive_joints:
        if name not in joints:
            raise ConfigurationError(
                f"robot.passive_joints: {name!r} is not one of robot.joints; {valid_choices(name, joints)}"
            )
    for name, position in locked_joints.items():
        _require_own_coordinate(full, name, "robot.locked_joints", own, mimics)
        if name in joints:
            raise ConfigurationError(f"robot.locked_joints: {name!r} is one of robot.joints, and moves")
        i = full.joints[full.getJointId(name)].idx_q
        low, high = full.lowerPositionLimit[i], full.upperPositionLimit[i]
        if not (low <= position <= high):
            raise ConfigurationError(
                f"robot.locked_joints: {position:g} rad for {name!r} is outside its limits [{low:g}, {high:g}] rad"
            )
    following = {name: mimic for name, mimic in mimics.items() if mimic.leader in joints}
    for name in following:
        _require_one_coordinate(full, name, f"robot.urdf: {name!r}, which mimics {following[name].leader!r},")
    for name, mimic in mimics.items():
        if name not in following and full.joints[full.getJointId(name)].nq == 1:
            locked_joints[name] = mimic.ratio * locked_joints.get(mimic.leader, 0.0) + mimic.offset
    locked_joints = {name: position for name, position in locked_joints.items() if position != 0.0}
    model = _lock(full, [name for name in own if name not in joints and name not in following], locked_joints)
    moving = [model.getJointId(name) for name in (*joints, *following)]
    q_of, v_of = (
        {str(model.names[i]): int(getattr(model.joints[i], key)) for i in moving} for key in ("idx_q", "idx_v")
    )
    q_index, v_index = (np.array([index[name] for name in joints], dtype=np.intp) for index in (q_of, v_of))
    followers = Followers(following, q_of, v_of) if following else None
    efforts = np.array(model.upperEffortLimit)[v_index]
    drive = make_drive(
        joints,
        efforts,
        actuators=actuators,
        transmission=transmission,
        passive=passive_joints,
        by_joint=commanded_by_joint,
    )
    coupling = followers.coupling(model.nv) if followers is not None else np.zeros((0, model.nv))
    actuation = Actuation(drive, v_index, coupling)
    joint_armature = np.array(model.armature)
    own = [name in drive.names and name not in (transmission or {}) for name in joints]
    joint_armature[v_index[own]] = armature
    model.armature = joint_armature
    lower, upper = np.array(model.lowerPositionLimit)[q_index], np.array(model.upperPositionLimit)[q_index]
    velocity_limits = np.array(model.upperVelocityLimit)[v_index]
    _require_velocity_limits(joints, velocity_limits)
    for name, mimic in following.items():
        _tighten(joints.index(mimic.leader), mimic, model, q_of[name], v_of[name], lower, upper, velocity_limits)
    result = RobotModel(
        pinocchio=model,
        urdf=urdf,
        joints=tuple(joints),
        floating_base=floating_base,
        q_index=q_index,
        v_index=v_index,
        velocity_limits=frozen(velocity_limits),
        position_lower=frozen(lower),
        position_upper=frozen(upper),
        posture=frozen(list(posture)),
        actuation=actuation,
        effort_limits=frozen(effort_limit_scale * actuation.effort_limits),
        passive=PassiveForces(passive_joints, q_of, v_of) if passive_joints else None,
        followers=followers,
        locked=MappingProxyType(locked_joints),
    )
    for name, value, low, high in zip(
        joints, result.posture, result.position_lower, result.position_upper, strict=True
    ):
        if not (low <= value <= high):
            raise ConfigurationError(
                f"robot.posture: {value} rad for {name!r} is outside its limits [{low}, {high}] rad"
            )
    return result


def _require_own_coordinate(
    full: pin.Model, name: str, key: str, own: Sequence[str], mimics: Mapping[str, Mimic]
) -> None:
    if name not in own:
        raise ConfigurationError(f"{key}: {name!r} is not a joint of the URDF; {valid_choices(name, own)}")
    if name in mimics:
        raise ConfigurationError(f"{key}: {name!r} mimics {mimics[name].leader!r} and follows it; name that one alone")
    _require_one_coordinate(full, name, f"{key}: {name!r}")


def _require_one_coordinate(full: pin.Model, name: str, subject: str) -> None:
    joint = full.joints[full.getJointId(name)]
    if joint.nv != 1 or joint.nq != 1:
        raise ConfigurationError(
            f"{subject} has {joint.nv} degrees of freedom in {joint.nq} coordinates; "
            "one revolute or prismatic joint with limits is needed"
        )


def _lock(full: pin.Model, names: Sequence[str], positions: Mapping[str, float]) -> pin.Model:
    """Lock joints at positions, rad; at zero where none is given."""
    q = pin.neutral(full)
    for name, position in positions.items():
        q[full.joints[full.getJointId(name)].idx_q] = position
    return pin.buildReducedModel(full, [full.getJointId(name) for name in names], q) if names else full


def _tighten(
    leader: int, mimic: Mimic, model: pin.Model, q: int, v: int, lower: Array, upper: Array, velocity: Array
) -> None:
    """Hold the limits of a joint that follows, at (q, v), by those of the joint that it follows."""
    if mimic.ratio == 0.0:
        return
    ends = (model.lowerPositionLimit[q] - mimic.offset, model.upperPositionLimit[q] - mimic.offset)
    low, high = sorted(end / mimic.ratio for end in ends)
    lower[leader], upper[leader] = max(lower[leader], low), min(upper[leader], high)
    velocity[leader] = min(velocity[leader], model.upperVelocityLimit[v] / abs(mimic.ratio))


def _require_velocity_limits(joints: Sequence[str], limits: np.ndarray) -> None:
    for name, limit in zip(joints, limits, strict=True):
        if not (0.0 < limit < np.inf):
            raise ConfigurationError(f"robot.urdf: joint {name!r} has the velocity limit {limit}; it must be positive")
