"""The frozen records that pass between the stages of one control cycle.

Conventions of the whole package: SI units; quaternions are (x, y, z, w); twists and wrenches have the linear part
first. For a floating base ``q = [base position in world, base quaternion, joints]`` and
``v = [base linear velocity, base angular velocity, joint velocities]``, with the base velocities expressed in the base
frame (Pinocchio's free flyer, and the twist of nav_msgs/Odometry after REP 105).
"""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def frozen(values: npt.ArrayLike) -> Array:
    """Return a read-only float copy of an array."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def freeze(array: Array) -> Array:
    """Make an array read-only without copying it; the caller guarantees that no other reference writes to it."""
    array.setflags(write=False)
    return array


def frozen_mapping(mapping: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a read-only copy of a mapping."""
    return MappingProxyType(dict(mapping))


@dataclass(frozen=True, slots=True)
class RobotState:
    """The robot's state, latched at the start of a cycle."""

    stamp: int  # source time of the joint state, in nanoseconds
    q: Array  # configuration, (nq,)
    v: Array  # generalized velocity, (nv,)


@dataclass(frozen=True, slots=True)
class Reference:
    """The reference of one task at one instant.

    Attributes:
        position: (k,) for vectors; (7,), position and quaternion, for the pose of a frame.
        velocity: (m,) feed-forward velocity, m = 6 for a pose.
        acceleration: (m,) feed-forward acceleration.
    """

    position: Array
    velocity: Array
    acceleration: Array


@dataclass(frozen=True, slots=True)
class Tuning:
    """Gains and limits that can be changed while the controller runs."""

    #: Gains by task and by name, each () or (size,): ``stiffness`` in 1/s² and ``damping`` in 1/s, or ``gain`` in 1/s.
    gains: Mapping[str, Mapping[str, Array]]
    position_margin: float  # distance kept from the joint position limits, rad
    position_horizon: float  # look-ahead time of the limits of joint position and velocity, s
    velocity_scale: float  # share of the velocity limits that may be used
    acceleration: float  # largest joint acceleration, rad/s²
    torque_rate: float  # torque rate limit, in effort limits per second


@dataclass(frozen=True, slots=True)
class Disturbance:
    """What acts on the robot beside its model, as generalized forces."""

    forces: Array  # all that is taken into account, (nv,) in N and N·m: known friction, and the estimate
    estimate: Array  # the part that is estimated, (nv,)
    at_bound: tuple[str, ...] = ()  # names of the joints, and ``base``, at which the estimate is as large as it may be


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """What a cycle has predicted, to be compared with the next state."""

    stamp: int  # of its state, ns
    v: Array  # velocity in that state, (nv,)
    v_dot: Array | None  # acceleration of the program, (nv,); None where it does not follow from the torques sent
    excess: Array  # generalized force of the torques sent, less that of the program's, (nv,) in N, N·m
    forces: Mapping[str, Array]  # what the contacts that held should carry, by name, in N, N·m
    M: Array  # mass matrix in that state, (nv, nv)
    J: Array  # stacked Jacobian of these contacts, (k, nv)


@dataclass(frozen=True, slots=True)
class References:
    """Everything that commands can set, sampled at the time of one cycle."""

    tasks: Mapping[str, Reference]  # reference of each task
    weights: Mapping[str, float]  # weight of each task, ramps applied; 0 switches a task off
    contacts: Mapping[str, float]  # activation of each contact, from 0 (inactive) to 1 (fully active), ramps applied
    #: Known external wrench at each named frame, (6,) in N and N·m, world axes (S4).
    external_wrenches: Mapping[str, Array] = field(default_factory=lambda: MappingProxyType({}))
    tuning: Tuning | None = None  # gains and limits, ramps applied; None keeps those that the controller was made with
    #: Anchor of each contact with a stiffness, (7,): its position in m and quaternion when it was activated, relative
    #: to the world or to the link that it touches.
    anchors: Mapping[str, Array] = field(default_factory=lambda: MappingProxyType({}))
    disturbance: Disturbance | None = None  # what acts beside the model; None where nothing is known


class LevelReport(NamedTuple):
    """The quadratic program of one priority level, as solved in one cycle."""

    tasks: tuple[str, ...]  # names of the tasks that took part in it
    cost: float  # cost of tasks and regularization at the solution, ½ Σ wᵢ ‖Jᵢ v̇ - bᵢ‖² + …
    iterations: int  # the solver's own count
    seconds: float  # solve time, s


class Details(Protocol):
    """What is read of a solution after the torques are on their way, if at all; it may be computed on first access.

    Attributes:
        forces: per active contact, the force (3,) or wrench (6,) in the contact frame, in N and N·m.
        residuals: largest absolute violation of each group of constraints, by name.
        task_errors: Euclidean norm of each task error, in the unit of the reference: m, rad, kg·m/s, N·m·s, N or N·m.
        binding: multiplier of each binding constraint, such as ``torque:left_knee_joint:upper``: the cost would fall by
            this much per unit by which the bound is relaxed; in N⁻¹ for contacts, (N·m)⁻¹ for torques, (rad/s²)⁻¹ for
            joint motion.
        levels: the quadratic programs that were solved, highest priority first.
    """

    @property
    def forces(self) -> Mapping[str, Array]: ...  # noqa: D102 - above

    @property
    def residuals(self) -> Mapping[str, float]: ...  # noqa: D102

    @property
    def task_errors(self) -> Mapping[str, float]: ...  # noqa: D102

    @property
    def binding(self) -> Mapping[str, float]: ...  # noqa: D102

    @property
    def levels(self) -> Sequence[LevelReport]: ...  # noqa: D102


class Solution(NamedTuple):
    """The solution of the quadratic program, with the residuals of its constraints.

    Attributes:
        v_dot: generalized acceleration, (nv,).
        tau: torques of the actuators in the order of the command, (na,) in N·m.
        details: contact forces, residuals and more, which are attributes of the solution, too.
        relaxed: groups of constraints that had to be relaxed for a solution to exist, and lower priority levels whose
            solver failed; normally empty.
        iterations: the solver's own count.
        stage_seconds: time spent in each stage of the computation, in s.
        external_wrenches: the known external wrenches that the solution accounts for, as in `References`.
        disturbance: what acts beside the model, likewise.
    """

    v_dot: Array
    tau: Array
    details: Details
    relaxed: tuple[str, ...] = ()
    iterations: int = 0
    stage_seconds: Mapping[str, float] = MappingProxyType({})
    external_wrenches: Mapping[str, Array] = MappingProxyType({})
    disturbance: Disturbance | None = None

    @property
    def forces(self) -> Mapping[str, Array]:
        """Those of `details`."""
        return self.details.forces

    @property
    def residuals(self) -> Mapping[str, float]:
        """Those of `details`."""
        return self.details.residuals

    @property
    def task_errors(self) -> Mapping[str, float]:
        """Those of `details`."""
        return self.details.task_errors

    @property
    def binding(self) -> Mapping[str, float]:
        """That of `details`."""
        return self.details.binding

    @property
    def levels(self) -> Sequence[LevelReport]:
        """Those of `details`."""
        return self.details.levels


@dataclass(frozen=True, slots=True)
class ChangeSettings:
    """A change of settings: part of a configuration, nested as in the file."""

    settings: Mapping[str, Any]


#: Words for the safety supervisor.
REQUESTS = ("activate", "deactivate", "damp", "reset", "estop")


class Mode(str, enum.Enum):
    """Modes of the safety supervisor."""

    INACTIVE = "inactive"
    ACTIVE = "active"
    HOLDING = "holding"
    DAMPING = "damping"
    STOPPED = "stopped"
    FAULT = "fault"


@dataclass(frozen=True, slots=True)
class Infeasibility:
    """Why a quadratic program is infeasible."""

    conflict: tuple[str, ...]  # names of the constraints that cannot hold together, as in `Solution.binding`
    #: The constraints of the conflict whose relaxation needs the least total slack; relaxing the others would be the
    #: alternative.
    smallest: tuple[str, ...]
    slack: Mapping[str, float]  # slack that each constraint of the conflict needs, in the relaxation that it belongs to
    units: Mapping[str, str]  # unit of each slack
    sentence: str  # the conflict in words


@dataclass(frozen=True, slots=True)
class Fault:
    """Why the controller left its active mode.

    Attributes:
        code: a short upper-case name, such as ``STALE_INPUT``.
        sentence: the reason in words.
        infeasibility: the conflicting constraints, if the program was infeasible and they are known.
    """

    code: str
    sentence: str
    infeasibility: Infeasibility | None = None


class JointCommand(NamedTuple):
    """The command to the joints; only `safety.supervisor.Supervisor` makes one.

    Attributes:
        stamp: source time of the state that this command was computed from, in nanoseconds.
        tau: torques of the actuators, in the order of the command, (na,) in N·m.
        q_desired: predicted joint positions one period ahead, (nj,) in rad; NaN where no solution predicts them.
        v_desired: predicted joint velocities one period ahead, (nj,) in rad/s; NaN where no solution predicts them.
    """

    stamp: int
    tau: Array
    q_desired: Array
    v_desired: Array


@dataclass(frozen=True, slots=True)
class AuditReport:
    """Whether the model explains the measured motion: filtered residuals between the last states."""

    energy: float  # energy residual: power that no torque accounts for, W
    throughput: float  # sum of the absolute powers of the joints, W: the scale for the energy residual
    force: Array  # force on the centre of mass that the model does not account for, world axes, (3,) in N
    joint_torques: Array  # torque at each joint that the model does not account for, (nj,) in N·m
    warnings: tuple[str, ...]  # one sentence for each residual that has been too large for too long
