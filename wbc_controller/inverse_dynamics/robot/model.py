"""Robot model: base, moving joints and actuation."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType

import numpy as np
import pinocchio as pin

from wbc_controller.errors import ConfigurationError, require_known, valid_choices
from wbc_controller.inverse_dynamics.arrays import as_slice
from wbc_controller.inverse_dynamics.robot.actuation import Actuation
from wbc_controller.inverse_dynamics.robot.mimic import Followers
from wbc_controller.records import Array
from wbc_controller.settings.robot import PassiveJointSettings


class PassiveForces:
    """Torques of springs and dampers, -k (q - q₀) - d q̇: part of the bias forces h (S1, S4)."""

    def __init__(self, joints: Mapping[str, PassiveJointSettings], q_index: np.ndarray, v_index: np.ndarray) -> None:
        self.joints = dict(joints)  # by name, (k,)
        self._q_index, self.v_index = q_index, v_index  # (k,) each
        self._stiffness = np.array([joint.stiffness for joint in joints.values()])
        self._damping = np.array([joint.damping for joint in joints.values()])
        self._rest = np.array([joint.rest for joint in joints.values()])

    def torques(self, q: Array, v: Array) -> Array:
        """Return the torques at a state, (k,) in N·m."""
        return np.asarray(self._stiffness * (self._rest - q[self._q_index]) - self._damping * v[self.v_index])


@dataclass(frozen=True)
class RobotModel:
    """Model of a robot."""

    pinocchio: pin.Model  # without locked joints
    urdf: str  # with the configured limits, and continuous joints as revolute ones
    joints: tuple[str, ...]  # moving and measured joints, (nj,)
    floating_base: bool
    q_index: np.ndarray  # (nj,)
    v_index: np.ndarray  # (nj,)
    velocity_limits: Array  # (nj,) in rad/s
    position_lower: Array  # (nj,) in rad
    position_upper: Array  # (nj,) in rad
    posture: Array  # nominal positions, (nj,) in rad
    actuation: Actuation  # in the order of the command
    effort_limits: Array  # usable torques, (na,) in N·m
    passive: PassiveForces | None = None  # springs and dampers of joints without a motor
    followers: Followers | None = None  # mimic joints
    locked: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))  # positions other than 0, rad

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
        """Number of moving and measured joints."""
        return len(self.joints)

    @cached_property
    def q_places(self) -> np.ndarray | slice:
        """`q_index`, as a slice if consecutive."""
        return as_slice(self.q_index)

    @cached_property
    def v_places(self) -> np.ndarray | slice:
        """`v_index`, as a slice if consecutive."""
        return as_slice(self.v_index)

    @cached_property
    def na(self) -> int:
        """Number of actuators."""
        return len(self.actuation.names)

    @property
    def actuators(self) -> tuple[str, ...]:
        """Names of the actuators in the order of the command."""
        return self.actuation.names

    @property
    def driven_joints(self) -> tuple[str, ...]:
        """Names of joints with an actuator."""
        return tuple(name for name, driven in zip(self.joints, self.actuation.driven, strict=True) if driven)

    @cached_property
    def moving_links(self) -> tuple[str, ...]:
        """Names of the links that a joint moves."""
        return tuple(f.name for f in self.pinocchio.frames if f.type == pin.BODY and f.parentJoint > 0)

    @property
    def moving_joints(self) -> tuple[str, ...]:
        """Names of all moving joints, with mimic joints."""
        return self.joints + (self.followers.names if self.followers is not None else ())

    @cached_property
    def units(self) -> tuple[str, ...]:
        """Unit of each joint position, (nj,): rad or m."""
        kinds = (self.pinocchio.joints[self.pinocchio.getJointId(name)].shortname() for name in self.joints)
        return tuple("m" if kind.startswith("JointModelP") else "rad" for kind in kinds)

    @cached_property
    def base_link(self) -> str:
        """Name of the floating base's link, or of the link fixed to the world."""
        links = (f for f in self.pinocchio.frames if f.type == pin.BODY and f.parentJoint == int(self.floating_base))
        return next((str(link.name) for link in links if link.name != "universe"), "universe")

    @property
    def name(self) -> str:
        """Name of the robot in its URDF."""
        return str(self.pinocchio.name)

    @property
    def mass(self) -> float:
        """Total mass, kg."""
        return float(pin.computeTotalMass(self.pinocchio))

    @cached_property
    def size(self) -> float:
        """Twice the length of the longest chain of links, at least 0.1 m."""
        model, norm = self.pinocchio, np.linalg.norm
        lengths = [0.0]
        for parent, placement in zip(model.parents[1:], model.jointPlacements[1:], strict=True):
            lengths.append(lengths[parent] + float(norm(placement.translation)))
        longest = max(lengths[frame.parentJoint] + norm(frame.placement.translation) for frame in model.frames)
        return max(2.0 * float(longest), 0.1)

    @property
    def gravity(self) -> float:
        """Magnitude of gravity, m/s²."""
        return float(np.linalg.norm(self.pinocchio.gravity.linear))

    def frame_id(self, name: str, key: str) -> int:
        """Return the id of the frame of a link, else of a joint; for an unknown one, the error begins with the key."""
        known = name.isprintable()  # Pinocchio raises on invalid UTF-8
        if known and self.pinocchio.existFrame(name, pin.BODY):
            return int(self.pinocchio.getFrameId(name, pin.BODY))
        if not (known and self.pinocchio.existFrame(name)):
            links = [frame.name for frame in self.pinocchio.frames if frame.type == pin.BODY]
            raise ConfigurationError(f"{key} = {name!r}: the robot has no such frame; {valid_choices(name, links)}")
        return int(self.pinocchio.getFrameId(name))

    def joint_columns(self, names: Sequence[str], key: str) -> np.ndarray:
        """Return the indices (k,) of joints in `joints`, by default all; refuses unknown joints."""
        require_known(names, self.joints, f"{key}:", " is not one of robot.joints")
        return np.array([self.joints.index(name) for name in names or self.joints], dtype=np.intp)

    def configuration(self, joint_positions: Array, base: pin.SE3 | None = None) -> Array:
        """Assemble q from joint positions (nj,) and the base's placement."""
        q = np.array(pin.neutral(self.pinocchio))
        if self.floating_base and base is not None:
            q[:7] = pin.SE3ToXYZQUAT(base)
        q[self.q_index] = joint_positions
        if self.followers is not None:
            self.followers.place(q)
        return q

    def state(
        self, joint_positions: Array, joint_velocities: Array, pose: Array | None = None, twist: Array | None = None
    ) -> tuple[Array, Array]:
        """Assemble q and v from joint states (nj,), base pose (7,) and local base twist (6,)."""
        q, v = np.zeros(self.nq), np.zeros(self.nv)
        if pose is not None and twist is not None:
            q[:7], v[:6] = pose, twist
        q[self.q_places] = joint_positions
        v[self.v_places] = joint_velocities
        if self.followers is not None:
            self.followers.place(q)
            self.followers.move(v)
        return q, v

    def difference(self, before: Array, after: Array) -> Array:
        """Return the motion between two configurations as a velocity over 1 s, (nv,)."""
        return np.asarray(pin.difference(self.pinocchio, before, after))

    def passive_force(self, q: Array, v: Array) -> Array:
        """Return the generalized force of passive springs and dampers, (nv,)."""
        force = np.zeros(self.nv)
        if self.passive is not None:
            force[self.passive.v_index] = self.passive.torques(q, v)
        return force

    def joint_beyond_limits(self, position: Array, margin: float) -> str:
        """Return the first joint beyond its position limits less a margin, or ""; the nominal posture is within."""
        low = position < np.minimum(self.position_lower + margin, self.posture)
        high = position > np.maximum(self.position_upper - margin, self.posture)
        return next((name for name, beyond in zip(self.joints, low | high, strict=True) if beyond), "")

    def joint_forces(self, force: Array) -> Array:
        """Return the joint components (nj,) of a generalized force (nv,), with mimic joints added to leaders."""
        if self.followers is not None:
            force = np.array(force)
            self.followers.carry(force)
        return np.asarray(force[self.v_index])
