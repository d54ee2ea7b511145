"""Records of one control cycle: latched inputs, controller inputs, report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from wbc_controller.controller.result import CycleResult
from wbc_controller.inverse_dynamics.references.changes import Change
from wbc_controller.records import Array, AuditReport, ChangeSettings, Fault, JointCommand, Mode, RobotState, Solution


class UserRequests(NamedTuple):
    """Requests of users for one cycle.

    Attributes:
        commands: words on the command topic, in order of arrival.
        changes: sets of changes, in order of arrival; each set is applied completely or not at all.
        refused: one sentence per refused request.
        total: number of received requests.
    """

    commands: tuple[str, ...] = ()
    changes: tuple[tuple[Change | ChangeSettings, ...], ...] = ()
    refused: tuple[str, ...] = ()
    total: int = 0


@dataclass(slots=True)  # not frozen: faster construction
class LatchedInputs:
    """Inputs latched at the start of one cycle.

    Attributes:
        state: newest state; None until all parts have arrived (joint states; for a floating base odometry or IMU).
        joint_velocity: newest joint velocities, (nj,) in rad/s; None before the first message.
        ages: age of each part of the state, s; infinite before the first message.
        clock_stall: advance of the timestamps during a clock stall, s.
        refused_states: one sentence per refused sensor message.
        requests: requests of users.
        estimate: diagnostics of the base estimate, by key.
    """

    state: RobotState | None
    joint_velocity: Array | None
    ages: Mapping[str, float]
    clock_stall: float = 0.0
    refused_states: tuple[str, ...] = ()
    requests: UserRequests = field(default_factory=UserRequests)
    estimate: Mapping[str, str] = field(default_factory=dict)

    @property
    def refused(self) -> tuple[str, ...]:
        """One sentence per refused message of sensors and users."""
        return self.refused_states + self.requests.refused


@dataclass(slots=True)
class CycleInputs:
    """Inputs of the controller in one cycle.

    Attributes:
        now: time on the loop's clock, s.
        state: latched state; None before the first one.
        joint_velocity: joint velocities, (nj,) in rad/s; None if stale.
        problem: fault of the inputs, or None.
        requests: requests to the supervisor, in order.
        changes: sets of changes, in order; each set is applied completely or not at all.
    """

    now: float
    state: RobotState | None
    joint_velocity: Array | None
    problem: Fault | None = None
    requests: tuple[str, ...] = ()
    changes: tuple[Sequence[Change | ChangeSettings], ...] = ()


@dataclass(slots=True)
class CycleReport:
    """Inputs and results of one cycle, for diagnostics and recordings. Read-only.

    Attributes:
        cycle: number of the cycle.
        inputs: latched inputs.
        result: mode, fault, command and solution.
        refused: one sentence per refused input since the last cycle.
        stage_seconds: time of each stage, s.
        deadlines_missed: missed deadlines since the start.
        audit: comparison of model and measured motion, or None.
        contested: one sentence per topic with conflicting publishers.
        shared: publishers of each input with several publishers, by topic.
    """

    cycle: int
    inputs: LatchedInputs
    result: CycleResult
    refused: tuple[str, ...]
    stage_seconds: Mapping[str, float]
    deadlines_missed: int
    audit: AuditReport | None = None
    contested: tuple[str, ...] = ()
    shared: Mapping[str, str] = field(default_factory=dict)

    @property
    def mode(self) -> Mode:
        """Mode after the cycle."""
        return self.result.mode

    @property
    def fault(self) -> Fault | None:
        """Latched fault, or None."""
        return self.result.fault

    @property
    def command(self) -> JointCommand | None:
        """Sent command, or None."""
        return self.result.command

    @property
    def solution(self) -> Solution | None:
        """Solution of the quadratic program, or None."""
        return self.result.solution

    @property
    def stamp(self) -> int:
        """Timestamp of the latched state, ns; 0 before the first one."""
        return 0 if self.inputs.state is None else self.inputs.state.stamp
