"""Immutable records between the stages of a cycle.

Conventions of the package: SI units; quaternions (x, y, z, w); twists and wrenches with the linear part first. For a
floating base ``q = [base position in world, base quaternion, joints]`` and
``v = [base linear velocity, base angular velocity, joint velocities]``, with base velocities in the base frame
(Pinocchio's free flyer; the twist of nav_msgs/Odometry after REP 105).
"""

import enum
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def frozen(values: npt.ArrayLike) -> Array:
    """Return a read-only copy of an array."""
    return freeze(np.array(values, dtype=np.float64))


def freeze(array: Array) -> Array:
    """Make an array read-only in place."""
    array.setflags(write=False)
    return array


def frozen_mapping(mapping: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a read-only copy of a mapping."""
    return MappingProxyType(dict(mapping))


@dataclass(frozen=True, slots=True)
class RobotState:
    """State of the robot, latched at the start of a cycle."""

    stamp: int  # timestamp of the joint state, ns
    q: Array  # configuration, (nq,)
    v: Array  # generalized velocity, (nv,)


@dataclass(slots=True)  # not frozen: faster construction
class Reference:
    """Reference of one task at one instant."""

    position: Array  # (k,); for a pose (7,), position and quaternion
    velocity: Array  # feed-forward velocity, (m,); m = 6 for a pose
    acceleration: Array  # feed-forward acceleration, (m,)


@dataclass(frozen=True, slots=True)
class Tuning:
    """Gains and limits that can change in a running controller."""

    #: Gains by task and name, each () or (size,): ``stiffness`` in 1/s² and ``damping`` in 1/s, or ``gain`` in 1/s.
    gains: Mapping[str, Mapping[str, Array]]
    position_margin: float  # distance to the joint position limits, rad
    position_horizon: float  # look-ahead time of joint position and velocity limits, s
    velocity_scale: float  # usable share of the velocity limits
    acceleration: float  # largest joint acceleration, rad/s²
    torque_rate: float  # torque rate limit, in effort limits per second


@dataclass(frozen=True, slots=True)
class Disturbance:
    """Generalized forces that the model does not contain: friction, payload, model error."""

    forces: Array  # known friction plus estimate, (nv,) in N and N·m
    estimate: Array  # estimate of the disturbance observer, (nv,)
    at_bound: tuple[str, ...] = ()  # joints, and ``base``, with a saturated estimate


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Predicted motion of a cycle, for comparison with the next state."""

    stamp: int  # timestamp of the state, ns
    v: Array  # velocity, (nv,)
    v_dot: Array | None  # acceleration of the solution, (nv,); None if the sent torques do not cause it
    excess: Array  # generalized force of sent torques minus solution torques, (nv,) in N, N·m
    forces: Mapping[str, Array]  # predicted forces of active contacts, in N, N·m
    M: Array  # mass matrix, (nv, nv)
    J: Array  # stacked Jacobian of active contacts, (k, nv)


@dataclass(frozen=True, slots=True)
class References:
    """Commanded references at the time of one cycle, with ramps applied."""

    tasks: Mapping[str, Reference]
    weights: Mapping[str, float]  # weight of each task; 0 disables it
    contacts: Mapping[str, float]  # activation of each contact, 0 (inactive) to 1 (fully active)
    #: Known external wrench at each frame, (6,) in N and N·m, world axes (S4).
    external_wrenches: Mapping[str, Array] = field(default_factory=lambda: MappingProxyType({}))
    tuning: Tuning | None = None  # gains and limits; None for the configured ones
    #: Anchor of each contact with stiffness, (7,): position in m and quaternion at activation, relative to the world or
    #: to the touched link.
    anchors: Mapping[str, Array] = field(default_factory=lambda: MappingProxyType({}))
    disturbance: Disturbance | None = None
    #: Share of the friction of each contact, 0 to 1; 1 by default.
    friction: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))


class LevelReport(NamedTuple):
    """Quadratic program of one priority level in one cycle."""

    tasks: tuple[str, ...]
    cost: float  # cost of tasks and regularization at the solution, ½ Σ wᵢ ‖Jᵢ v̇ - bᵢ‖² + …
    iterations: int  # iterations of the solver
    seconds: float  # solve time, s


@dataclass(frozen=True, eq=False)
class Solution:
    """Solution of the quadratic program; `formulation.unpacking` computes fields without `init` on first access."""

    v_dot: Array  # generalized acceleration, (nv,)
    tau: Array  # in the order of the command, (na,) in N·m
    #: relaxed groups of constraints, and lower priority levels without a solution; normally empty
    relaxed: tuple[str, ...] = ()
    iterations: int = 0  # iterations of the solver
    stage_seconds: Mapping[str, float] = field(default_factory=dict)  # time of each stage, s
    external_wrenches: Mapping[str, Array] = field(default_factory=dict)  # known external wrenches, as in `References`
    disturbance: Disturbance | None = None  # disturbance, as in `References`
    #: force (3,) or wrench (6,) of each active contact in the contact frame, N and N·m
    forces: Mapping[str, Array] = field(init=False)
    residuals: Mapping[str, float] = field(init=False)  # largest absolute violation of each group of constraints
    task_errors: Mapping[str, float] = field(init=False)  # norm of each task error, in the unit of the reference
    #: multiplier of each binding constraint, such as ``torque:left_knee_joint:upper``: decrease of the cost per unit of
    #: relaxation, in N⁻¹, (N·m)⁻¹ or (rad/s²)⁻¹
    binding: Mapping[str, float] = field(init=False)
    levels: Sequence[LevelReport] = field(init=False)  # solved quadratic programs, highest priority first

    @property
    def details(self) -> "Solution":
        """The solution itself."""
        return self


@dataclass(frozen=True, slots=True)
class ChangeSettings:
    """Change of settings: part of a configuration, nested as in the file."""

    settings: Mapping[str, Any]


REQUESTS = ("activate", "deactivate", "damp", "reset", "estop")  # requests to the safety supervisor


class Mode(str, enum.Enum):
    """Modes of the safety supervisor."""

    INACTIVE = "inactive"
    ACTIVE = "active"
    HOLDING = "holding"
    DAMPING = "damping"
    STOPPED = "stopped"
    FAULT = "fault"


IN_CONTROL = (Mode.ACTIVE, Mode.HOLDING)  # modes with torques of a solution


@dataclass(frozen=True, slots=True)
class Infeasibility:
    """Conflict of constraints in an infeasible quadratic program."""

    conflict: tuple[str, ...]  # names of the conflicting constraints, as in `Solution.binding`
    smallest: tuple[str, ...]  # constraints with the smallest total slack; the others are the alternative relaxation
    slack: Mapping[str, float]  # required slack of each constraint within its relaxation
    units: Mapping[str, str]  # unit of each slack
    sentence: str  # description


@dataclass(frozen=True, slots=True)
class Fault:
    """Reason for leaving the active mode."""

    code: str  # short upper-case name, such as ``STALE_INPUT``
    sentence: str  # description
    infeasibility: Infeasibility | None = None  # conflicting constraints of an infeasible program, or None


class JointCommand(NamedTuple):
    """Command to the joints, created only by `safety.supervisor.Supervisor`."""

    stamp: int  # timestamp of the state that it answers, ns
    tau: Array  # in the order of the command, (na,) in N·m
    q_desired: Array  # after one period, (nj,) in rad; NaN without a prediction
    v_desired: Array  # after one period, (nj,) in rad/s; NaN without a prediction


@dataclass(frozen=True, slots=True)
class AuditReport:
    """Filtered residuals between the model and the measured motion."""

    energy: float  # unexplained power, W
    throughput: float  # scale of the energy residual: sum of the absolute joint powers, W
    force: Array  # unexplained force on the centre of mass, world axes, (3,) in N
    joint_torques: Array  # unexplained joint torques, (nj,) in N·m
    warnings: tuple[str, ...]  # one sentence for each residual that stays too large
