"""The guard's decisions: torques for a robot whose controller has stopped commanding it, and silence otherwise.

::

    idle ── commands come ──> watching ── none in time ──> damping ── damping_time ──> zero ── 1 s ──> released
      ^ <── the controller       ^                            │                          │                │
            has let go           └─────────────── a command comes, in any of these ──────┴────────────────┘

Idle, watching and released send nothing. The guard never sends while the controller does: two writers on one topic
would be a race.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

import numpy as np

from wbc_controller.records import Array, Mode, frozen

#: Modes in which the controller may end its commands, once they are zero.
_ENDED = (Mode.INACTIVE, Mode.STOPPED, Mode.FAULT)
#: Time for which zero torques are sent before the guard is silent, s: no reader misses all of them.
ZEROS = 1.0


class GuardMode(str, enum.Enum):
    """What the guard does."""

    IDLE = "idle"
    WATCHING = "watching"
    DAMPING = "damping"
    ZERO = "zero"
    RELEASED = "released"


@dataclass(frozen=True, slots=True)
class GuardLimits:
    """What the guard holds.

    Attributes:
        patience: time that a command may be late, s.
        period: time between the controller's commands, s.
        triggered: whether the controller commands in answer to a joint state, and not at a time.
        state_timeout: oldest joint state that damping is computed from, and after which a controller that is triggered
            commands without one, s.
        damping: joint damping, N·m·s/rad.
        damping_time: time of damping before the torques are zero, s.
        damping_torque: largest damping torque, (na,) in N·m.
        torque_step: largest change of a torque from one message to the next, (na,) in N·m.
        effort: largest torque, (na,) in N·m.
    """

    patience: float
    period: float
    triggered: bool
    state_timeout: float
    damping: float
    damping_time: float
    damping_torque: Array
    torque_step: Array
    effort: Array


@dataclass(frozen=True, slots=True)
class Heard:
    """What the guard has heard at one instant; times are arrivals on its own clock.

    Attributes:
        command_at: of the newest command, s; -inf where none has come.
        torques: of that command, (na,) in N·m.
        unanswered_at: of the first joint state after that command, s; inf where none has come.
        mode: what the controller said last that it is in; None where it has not.
        velocity: newest joint velocities as far as the actuators move the joints (`Drive.from_joints`), (na,) in rad/s;
            None where none have come.
        velocity_at: their arrival, s.
    """

    command_at: float
    torques: Array
    unanswered_at: float
    mode: Mode | None
    velocity: Array | None
    velocity_at: float


class Guard:
    """Decides at each instant whether the guard sends, and what.

    Attributes:
        limits: what it holds.
        mode: what it does.
        reason: why it damps, for a person to read; empty where it does not.
        takeovers: how often it has begun to damp.
    """

    def __init__(self, limits: GuardLimits) -> None:
        self.mode = GuardMode.IDLE
        self.reason = ""
        self.takeovers = 0
        self.limits = limits
        self._since = 0.0  # when the present mode began, s
        self._command_at = -math.inf  # of the command that the present mode counts from, s
        self._tau = np.zeros(len(limits.effort))  # last torques on the topic, the controller's or ours

    @property
    def sending(self) -> bool:
        """Whether torques are sent."""
        return self.mode in (GuardMode.DAMPING, GuardMode.ZERO)

    def deadline(self, heard: Heard) -> float:
        """Time at which the next command is so late that the guard takes over, s; inf where none is expected.

        A controller that is triggered owes a command to each joint state, and where none comes, one when they are
        stale; another one owes one in each period.
        """
        limits = self.limits
        if heard.command_at == -math.inf or (heard.mode in _ENDED and not heard.torques.any()):
            return math.inf
        due = heard.command_at + limits.period
        if limits.triggered:
            due = min(heard.unanswered_at, due + limits.state_timeout)
        return due + limits.patience

    def step(self, now: float, heard: Heard) -> Array | None:
        """Decide.

        Args:
            now: s.
            heard: everything until now.

        Returns:
            Torques to send, (na,) in N·m; None where nothing is to be sent.
        """
        deadline = self.deadline(heard)
        if heard.command_at > self._command_at or not (self.sending or self.mode is GuardMode.RELEASED):
            self._command_at = heard.command_at
            self.reason = ""
            if not (now >= deadline):
                self._enter(GuardMode.IDLE if deadline == math.inf else GuardMode.WATCHING, now)
                return None
            self._take_over(now, heard)
        if self.mode is GuardMode.DAMPING and not (now - self._since < self.limits.damping_time):
            self._enter(GuardMode.ZERO, now)
        if self.mode is GuardMode.ZERO and not (now - self._since < ZEROS) and not self._tau.any():
            self._enter(GuardMode.RELEASED, now)
        return self._torques(now, heard) if self.sending else None

    def blind(self, now: float, heard: Heard) -> bool:
        """Whether there are no fresh joint velocities to damp with."""
        fresh = now - heard.velocity_at <= self.limits.state_timeout
        return heard.velocity is None or not fresh or not np.isfinite(heard.velocity).all()

    def _take_over(self, now: float, heard: Heard) -> None:
        silence = now - heard.command_at
        self.reason = f"COMMANDS_STOPPED: the last command came {1e3 * silence:.0f} ms ago"
        if heard.mode is not None:
            self.reason += f", in mode {heard.mode.value}"
        self.takeovers += 1
        limits = self.limits
        usable = np.isfinite(heard.torques).all()
        self._tau = np.clip(heard.torques, -limits.effort, limits.effort) if usable else np.zeros(len(limits.effort))
        self._enter(GuardMode.DAMPING, now)

    def _enter(self, mode: GuardMode, now: float) -> None:
        if mode is not self.mode:
            self.mode, self._since = mode, now

    def _torques(self, now: float, heard: Heard) -> Array:
        limits = self.limits
        wanted = np.zeros(len(limits.effort))
        if self.mode is GuardMode.DAMPING and heard.velocity is not None and not self.blind(now, heard):
            wanted = np.clip(-limits.damping * heard.velocity, -limits.damping_torque, limits.damping_torque)
        self._tau = np.clip(wanted, self._tau - limits.torque_step, self._tau + limits.torque_step)
        return frozen(self._tau)
