"""Records of one control cycle: its latched inputs, the inputs of the controller, and the report of its results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from wbc_controller.controller.result import CycleResult
from wbc_controller.inverse_dynamics.references.changes import Change
from wbc_controller.records import Array, AuditReport, ChangeSettings, Fault, JointCommand, Mode, RobotState, Solution


class UserRequests(NamedTuple):
    """Requests of users that one cycle takes.

    Attributes:
        commands: words on the command topic, in order of arrival.
        changes: sets of changes, in order of arrival; each set is applied whole or not at all.
        refused: one sentence for each refused request.
        total: number of requests that were read, refused or turned away.
    """

    commands: tuple[str, ...] = ()
    changes: tuple[tuple[Change | ChangeSettings, ...], ...] = ()
    refused: tuple[str, ...] = ()
    total: int = 0


@dataclass(slots=True)  # not frozen, which would take three times as long to make, in every cycle
class LatchedInputs:
    """All inputs, latched at the start of one cycle.

    Attributes:
        state: the newest state; None until all of its parts have arrived (joint states, and for a floating base its
            odometry, or IMU data from which it has been estimated).
        joint_velocity: newest joint velocities, (nj,) in rad/s; None until they have arrived.
        ages: age of each part of the state, s; infinite if it has never arrived.
        clock_stall: advance of the timestamps during a stall of the clock, s.
        refused_states: one sentence for each refused message of a sensor.
        requests: requests of users.
        estimate: diagnostics of the base's estimate, by key.
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
        """One sentence for each refused message, of sensors and users."""
        return self.refused_states + self.requests.refused


@dataclass(slots=True)
class CycleInputs:
    """The inputs of the controller in one cycle.

    Attributes:
        now: time on the clock of the loop, s.
        state: the latched state; None before the first one.
        joint_velocity: joint velocities, (nj,) in rad/s; None if stale.
        problem: fault of the inputs, or None.
        requests: words for the supervisor, in order.
        changes: sets of changes, in order; each set is applied whole or not at all.
    """

    now: float
    state: RobotState | None
    joint_velocity: Array | None
    problem: Fault | None = None
    requests: tuple[str, ...] = ()
    changes: tuple[Sequence[Change | ChangeSettings], ...] = ()


@dataclass(slots=True)
class CycleReport:
    """Inputs and results of one cycle, for diagnostics and recordings; observers do not change it.

    Attributes:
        cycle: running number of the cycle.
        inputs: the latched inputs.
        result: mode, fault, command and solution.
        refused: one sentence for each input that was refused since the last cycle.
        stage_seconds: time spent in each stage, s.
        deadlines_missed: count of missed deadlines since the start.
        audit: comparison of the model with the measured motion; None if it could not be evaluated.
        contested: one sentence for each topic on which other nodes publish that exclude the controller or each other.
        shared: node names of all publishers of an input with several publishers, by the topic's name.
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
        """The latched fault, or None."""
        return self.result.fault

    @property
    def command(self) -> JointCommand | None:
        """The command that was sent, or None."""
        return self.result.command

    @property
    def solution(self) -> Solution | None:
        """The solution of the quadratic program, or None if none was computed."""
        return self.result.solution

    @property
    def stamp(self) -> int:
        """Timestamp of the latched state, ns; 0 before the first one."""
        return 0 if self.inputs.state is None else self.inputs.state.stamp
