"""Records of one control cycle."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from wbc_controller.controller.result import CycleResult
from wbc_controller.inverse_dynamics.references.changes import Change
from wbc_controller.records import Array, AuditReport, ChangeSettings, Fault, JointCommand, Mode, RobotState, Solution


class UserRequests(NamedTuple):
    """Requests of users for one cycle."""

    commands: tuple[str, ...] = ()  # words on the command topic, in order of arrival
    #: sets of changes, in order of arrival; each set is applied completely or not at all
    changes: tuple[tuple[Change | ChangeSettings, ...], ...] = ()
    refused: tuple[str, ...] = ()  # one sentence per refused request
    total: int = 0  # number of received requests


@dataclass(slots=True)  # not frozen: faster construction
class LatchedInputs:
    """Inputs latched at the start of one cycle."""

    state: RobotState | None  # newest; None until all parts have arrived
    joint_velocity: Array | None  # newest, (nj,) in rad/s; None before the first message
    ages: Mapping[str, float]  # age of each part of the state, s; infinite before the first message
    clock_stall: float = 0.0  # advance of the timestamps during a clock stall, s
    refused_states: tuple[str, ...] = ()  # one sentence per refused sensor message
    requests: UserRequests = field(default_factory=UserRequests)
    estimate: Mapping[str, str] = field(default_factory=dict)  # diagnostics of the base estimate, by key
    touching: Mapping[str, bool] = field(default_factory=dict)  # by contact

    @property
    def refused(self) -> tuple[str, ...]:
        """One sentence per refused message of sensors and users."""
        return self.refused_states + self.requests.refused


@dataclass(slots=True)
class CycleInputs:
    """Inputs of the controller in one cycle."""

    now: float  # time on the loop's clock, s
    state: RobotState | None  # latched state; None before the first one
    joint_velocity: Array | None  # (nj,) in rad/s; None if stale
    problem: Fault | None = None  # of the inputs
    requests: tuple[str, ...] = ()  # requests to the supervisor, in order
    #: sets of changes, in order; each set is applied completely or not at all
    changes: tuple[Sequence[Change | ChangeSettings], ...] = ()
    #: states of the contact sensors, by contact: True under load; without contacts that have no fresh sensor
    touching: Mapping[str, bool] = field(default_factory=dict)
    torques_sent: Array | None = None  # (na,) in N·m, if not those of the last result


@dataclass(slots=True)
class CycleReport:
    """Inputs and results of one cycle, for diagnostics and recordings. Read-only."""

    cycle: int
    inputs: LatchedInputs
    result: CycleResult
    refused: tuple[str, ...]  # one sentence per refused input since the last cycle
    stage_seconds: Mapping[str, float]  # s, by stage
    deadlines_missed: int  # missed deadlines since the start
    audit: AuditReport | None = None  # comparison of model and measured motion, or None
    contested: tuple[str, ...] = ()  # one sentence per topic with conflicting publishers
    shared: Mapping[str, str] = field(default_factory=dict)  # publishers of each input with several, by topic

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
