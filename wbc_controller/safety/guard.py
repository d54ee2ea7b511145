"""The guard's decisions: it commands torques only while the controller has stopped commanding the robot.

::

    idle ── commands come ──> watching ── none in time ──> damping ── damping_time ──> zero ── 1 s ──> released
      ^ <── the controller       ^                            │                          │                │
            has let go           └─────────────── a command comes, in any of these ──────┴────────────────┘

In idle, watching and released the guard sends nothing. It never sends while the controller does: two writers on one
topic would be a race.
"""

import enum
import math
from dataclasses import dataclass

import numpy as np

from wbc_controller.records import Array, Mode, frozen

#: Modes in which the controller may stop commanding once its torques are zero.
_ENDED = (Mode.INACTIVE, Mode.STOPPED, Mode.FAULT)
#: Time for which zero torques are sent before the guard stops sending, s: long enough that no reader misses all.
ZEROS = 1.0


class GuardMode(str, enum.Enum):
    """Modes of the guard."""

    IDLE = "idle"
    WATCHING = "watching"
    DAMPING = "damping"
    ZERO = "zero"
    RELEASED = "released"


@dataclass(frozen=True, slots=True)
class GuardLimits:
    """Timing and limits of the guard."""

    patience: float  # time by which a command may be late, s
    period: float  # time between the controller's commands, s
    triggered: bool  # whether the controller sends a command for each joint state, instead of periodically
    # largest age of joint velocities used for damping, s; also the time after which a triggered controller sends a
    # command without a new joint state
    state_timeout: float
    damping: Array  # K of the damping torques -K v, (na, nj): v are the joint velocities
    damping_time: float  # time of damping before the torques are zero, s
    damping_torque: Array  # largest damping torque, (na,) in N·m
    torque_rate: Array  # largest change of a torque, (na,) in N·m/s; by one period's worth at most per message
    effort: Array  # largest torque, (na,) in N·m


@dataclass(frozen=True, slots=True)
class Heard:
    """The latched sample of messages that the guard has received; times are arrival times on its own clock."""

    command_at: float  # arrival of the newest command, s; -inf where none has arrived
    torques: Array  # torques of the newest command, (na,) in N·m
    unanswered_at: float  # arrival of the first joint state after the newest command, s; inf where none has arrived
    mode: Mode | None  # last mode that the controller has reported; None where it has reported none
    velocity: Array | None  # newest joint velocities, (nj,) in rad/s; None where none have arrived
    velocity_at: float  # arrival of the newest joint velocities, s


class Guard:
    """Decides at each instant whether the guard sends torques, and which.

    Attributes:
        reason: why the guard has taken over, in words; empty before a takeover, and once the controller is back.
        takeovers: number of times that the guard has started to damp.
    """

    def __init__(self, limits: GuardLimits) -> None:
        self.mode = GuardMode.IDLE
        self.reason = ""
        self.takeovers = 0
        self.limits = limits
        self._since = 0.0  # when the present mode began, s
        self._command_at = -math.inf  # arrival of the newest command taken into account, s
        self._tau = np.zeros(len(limits.effort))  # last torques on the topic, the controller's or the guard's
        self._tau_at = -math.inf  # when these came, or were sent, s

    @property
    def sending(self) -> bool:
        """Whether torques are sent."""
        return self.mode in (GuardMode.DAMPING, GuardMode.ZERO)

    def deadline(self, heard: Heard) -> float:
        """Time at which the guard takes over if no command arrives, s; inf where no command is expected.

        A triggered controller has to send a command for each joint state, and also when no joint state has arrived for
        `state_timeout`; any other controller has to send a command in each period.
        """
        limits = self.limits
        if heard.command_at == -math.inf or (heard.mode in _ENDED and not heard.torques.any()):
            return math.inf
        due = heard.command_at + limits.period
        if limits.triggered:
            due = min(heard.unanswered_at, due + limits.state_timeout)
        return due + limits.patience

    def step(self, now: float, heard: Heard) -> Array | None:
        """Update the mode, and compute the torques to send.

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
        """Whether there are no fresh joint velocities for damping."""
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
        self._tau_at = heard.command_at
        self._enter(GuardMode.DAMPING, now)

    def _enter(self, mode: GuardMode, now: float) -> None:
        if mode is not self.mode:
            self.mode, self._since = mode, now

    def _torques(self, now: float, heard: Heard) -> Array:
        limits = self.limits
        wanted = np.zeros(len(limits.effort))
        if self.mode is GuardMode.DAMPING and heard.velocity is not None and not self.blind(now, heard):
            wanted = np.clip(-(limits.damping @ heard.velocity), -limits.damping_torque, limits.damping_torque)
        step = limits.torque_rate * max(0.0, min(now - self._tau_at, limits.period))
        self._tau, self._tau_at = np.clip(wanted, self._tau - step, self._tau + step), now
        return frozen(self._tau)
