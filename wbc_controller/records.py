"""The frozen records that pass between the stages of one control cycle.

Conventions, everywhere in this package: SI units; quaternions are (x, y, z, w); twists and wrenches have the linear
part first. For a floating base ``q = [base position in world, base quaternion, joints]`` and
``v = [base linear velocity, base angular velocity, joint velocities]``, the base's velocities expressed in the base
frame (Pinocchio's free flyer, and the twist of nav_msgs/Odometry after REP 105).
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def frozen(values: npt.ArrayLike) -> Array:
    """Return a read-only float copy of an array."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def freeze(array: Array) -> Array:
    """Make an array that nobody else writes to read-only, without a copy."""
    array.setflags(write=False)
    return array


def frozen_mapping(mapping: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a read-only copy of a mapping."""
    return MappingProxyType(dict(mapping))


@dataclass(frozen=True, slots=True)
class RobotState:
    """One state of the robot, as latched at the start of a cycle.

    Attributes:
        stamp: source time of the joint state, in nanoseconds.
        q: configuration, (nq,).
        v: generalized velocity, (nv,).
    """

    stamp: int
    q: Array
    v: Array


@dataclass(frozen=True, slots=True)
class Reference:
    """What one task should follow at one instant.

    Attributes:
        position: (k,) for vectors; (7,) position and quaternion for a frame's pose.
        velocity: (m,) feed-forward velocity, m = 6 for a pose.
        acceleration: (m,) feed-forward acceleration.
    """

    position: Array
    velocity: Array
    acceleration: Array


@dataclass(frozen=True, slots=True)
class Tuning:
    """The numbers of the controller that can be changed while it runs.

    Attributes:
        gains: of each task its gains by name, each () or (size,): ``stiffness`` in 1/s² and ``damping`` in 1/s, or
            ``gain`` in 1/s.
        position_margin: distance kept from the joints' position limits, rad.
        position_horizon: time over which these look ahead, s.
        velocity_scale: share of the velocity limits that may be used.
        acceleration: largest joint acceleration, rad/s².
        torque_rate: largest torque change, in effort limits per second.
    """

    gains: Mapping[str, Mapping[str, Array]]
    position_margin: float
    position_horizon: float
    velocity_scale: float
    acceleration: float
    torque_rate: float


@dataclass(frozen=True, slots=True)
class References:
    """Everything that commands set, sampled at one cycle's time.

    Attributes:
        tasks: reference of each task.
        weights: weight of each task, ramps applied; 0 switches a task off.
        contacts: activation of each contact, from 0 (broken) to 1 (made), ramps applied.
        external_wrenches: known external wrench at each named frame, (6,) in N and N·m, world axes (S4).
        tuning: gains and limits, ramps applied; None for those that the controller was made with.
        anchors: where each contact with a stiffness was made, (7,): position in m and quaternion in what it touches.
    """

    tasks: Mapping[str, Reference]
    weights: Mapping[str, float]
    contacts: Mapping[str, float]
    external_wrenches: Mapping[str, Array] = field(default_factory=lambda: MappingProxyType({}))
    tuning: Tuning | None = None
    anchors: Mapping[str, Array] = field(default_factory=lambda: MappingProxyType({}))


@dataclass(frozen=True, slots=True)
class LevelReport:
    """One quadratic program of a cycle: that of one priority.

    Attributes:
        tasks: names of its tasks that took part.
        cost: of the tasks and the regularization at the answer, ½ Σ wᵢ ‖Jᵢ v̇ - bᵢ‖² + ….
        iterations: the solver's own count.
        seconds: time that it took, s.
    """

    tasks: tuple[str, ...]
    cost: float
    iterations: int
    seconds: float


@dataclass(frozen=True, slots=True)
class Solution:
    """The answer of the quadratic program, with the residual of every equality.

    Its mappings may be made when they are first read: they cost nothing where nobody does.

    Attributes:
        v_dot: generalized acceleration, (nv,).
        tau: torques of the actuators in the order of the command, (na,) in N·m.
        forces: per made contact, the force (3,) or wrench (6,) in the contact frame, in N and N·m.
        residuals: largest absolute violation of each group of constraints, by name.
        task_errors: Euclidean norm of each task's error, in the unit of its reference: m, rad, kg·m/s, N·m·s, N or N·m.
        binding: the constraints that hold with equality, such as ``torque:left_knee_joint:upper``, and what each
            costs: its multiplier, by which the cost would fall per unit of the bound, in N⁻¹ for contacts, (N·m)⁻¹ for
            torques, (rad/s²)⁻¹ for joint motion.
        relaxed: groups of constraints that had to be relaxed for a solution to exist, and levels below the first whose
            solver failed; normally empty.
        iterations: the solver's own count.
        levels: the quadratic programs that were solved, by falling priority.
        stage_seconds: time spent in each stage of the computation, in s.
        external_wrenches: the known external wrenches that were counted on, as in `References`.
    """

    v_dot: Array
    tau: Array
    forces: Mapping[str, Array]
    residuals: Mapping[str, float]
    task_errors: Mapping[str, float]
    binding: Mapping[str, float]
    iterations: int
    levels: tuple[LevelReport, ...] = ()
    relaxed: tuple[str, ...] = ()
    stage_seconds: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    external_wrenches: Mapping[str, Array] = field(default_factory=lambda: MappingProxyType({}))


@dataclass(frozen=True, slots=True)
class ChangeSettings:
    """Change settings: a part of a configuration, nested as in its file."""

    settings: Mapping[str, Any]


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
    """Why a quadratic program has no answer.

    Attributes:
        conflict: names of the constraints that cannot hold together, as in `Solution.binding`.
        smallest: those of them that give in the smallest reconciliation; the others are what would have to give
            instead.
        slack: by how much each of the conflict gives, on its side.
        units: unit of each slack.
        sentence: the same for a person to read.
    """

    conflict: tuple[str, ...]
    smallest: tuple[str, ...]
    slack: Mapping[str, float]
    units: Mapping[str, str]
    sentence: str


@dataclass(frozen=True, slots=True)
class Fault:
    """Why the controller left its active mode.

    Attributes:
        code: a short upper-case name, such as ``STALE_INPUT``.
        sentence: the reason, for a person to read.
        infeasibility: which constraints conflict, where that is the reason and is known.
    """

    code: str
    sentence: str
    infeasibility: Infeasibility | None = None


@dataclass(frozen=True, slots=True)
class JointCommand:
    """What goes to the joints. Only `safety.supervisor.Supervisor` makes one.

    Attributes:
        stamp: source time of the state that this command answers, in nanoseconds.
        tau: torques of the actuators, in their order, (na,) in N·m.
        q_desired: joint positions that the torques lead to, (nj,) in rad; NaN where there is none.
        v_desired: joint velocities that the torques lead to, (nj,) in rad/s; NaN where there is none.
    """

    stamp: int
    tau: Array
    q_desired: Array
    v_desired: Array


@dataclass(frozen=True, slots=True)
class AuditReport:
    """Whether the model accounts for the motion: residuals between the last states, filtered.

    Attributes:
        energy: power that no torque accounts for, W.
        throughput: sum of the absolute powers of the joints, W: what the energy residual is to be measured against.
        force: force on the centre of mass that the model does not account for, world axes, (3,) in N.
        joint_torques: the same for each joint, (nj,) in N·m.
        warnings: a sentence for each residual that has been too large for too long.
    """

    energy: float
    throughput: float
    force: Array
    joint_torques: Array
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class CycleReport:
    """What one cycle did, for diagnostics and recordings.

    Attributes:
        cycle: running number of the cycle.
        stamp: source time of the state, in nanoseconds; 0 where none has arrived.
        mode: mode after the cycle.
        fault: the fault that is in force, if any.
        command: the command that was sent, if any.
        solution: the answer of the quadratic program, if one was computed.
        ages: age of each input at the start of the cycle, in s; infinite where none has arrived.
        refused: sentences about the inputs that were refused since the last cycle.
        stage_seconds: time spent in each stage, in s.
        deadlines_missed: count of missed deadlines since the start.
        audit: whether the model accounts for the motion, where that can be told.
    """

    cycle: int
    stamp: int
    mode: Mode
    fault: Fault | None
    command: JointCommand | None
    solution: Solution | None
    ages: Mapping[str, float]
    refused: tuple[str, ...]
    stage_seconds: Mapping[str, float]
    deadlines_missed: int
    audit: AuditReport | None = None
