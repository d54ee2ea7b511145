"""Decisions of the guard.

::

    idle ── commands come ──> watching ── none in time ──> damping ── damping_time ──> zero ── 1 s ──> released
      ^ <── the controller       ^                            │                          │                │
            has let go           └─────────────── a command comes, in any of these ──────┴────────────────┘

In idle, watching and released the guard sends nothing.
"""

import enum
import math
from dataclasses import dataclass

import numpy as np

from wbc_controller.records import Array, Mode, frozen

#: Modes in which the controller may stop commanding after zero torques.
_ENDED = (Mode.INACTIVE, Mode.STOPPED, Mode.FAULT)
#: Duration of zero torques before the guard stops sending, s.
ZERO_TIME = 1.0


class GuardMode(str, enum.Enum):
    """Mode of the guard."""

    IDLE = "idle"
    WATCHING = "watching"
    DAMPING = "damping"
    ZERO = "zero"
    RELEASED = "released"


@dataclass(frozen=True, slots=True)
class GuardLimits:
    """Timing and limits of the guard."""

    patience: float  # largest delay of a command, s
    period: float  # time between the controller's commands, s
    triggered: bool  # True if each joint state triggers a command
    state_timeout: float  # largest age of velocities for damping, and of joint states for a triggered controller, s
    damping: Array  # K of the damping torques -K v, (na, nj)
    damping_time: float  # time of damping before the torques are zero, s
    damping_torque: Array  # largest damping torque, (na,) in N·m
    torque_rate: Array  # torque rate limit, (na,) in N·m/s, over at most one period per message
    effort: Array  # largest torque, (na,) in N·m


@dataclass(frozen=True, slots=True)
class GuardInputs:
    """Latched messages of the guard; times are arrival times on its clock."""

    command_at: float  # newest command, s; -inf without any
    torques: Array  # newest command, (na,) in N·m
    unanswered_at: float  # first joint state after the newest command, s; inf without any
    mode: Mode | None  # last reported mode of the controller, or None
    velocity: Array | None  # newest joint velocities, (nj,) in rad/s, or None
    velocity_at: float  # newest joint velocities, s


class Guard:
    """Decides when the guard sends torques, and which; `reason` explains a takeover."""

    def __init__(self, limits: GuardLimits) -> None:
        self.mode = GuardMode.IDLE
        self.reason = ""
        self.takeovers = 0
        self.limits = limits
        self._since = 0.0  # start of the present mode, s
        self._command_at = -math.inf  # arrival of the newest processed command, s
        self._tau = np.zeros(len(limits.effort))  # last torques on the topic
        self._tau_at = -math.inf  # their time, s

    @property
    def sending(self) -> bool:
        """True if the guard sends torques."""
        return self.mode in (GuardMode.DAMPING, GuardMode.ZERO)

    def deadline(self, inputs: GuardInputs) -> float:
        """Return the time of the takeover without a new command, s, or inf."""
        limits = self.limits
        if inputs.command_at == -math.inf or (inputs.mode in _ENDED and not inputs.torques.any()):
            return math.inf
        due = inputs.command_at + limits.period
        if limits.triggered:
            due = min(inputs.unanswered_at, due + limits.state_timeout)
        return due + limits.patience

    def step(self, now: float, inputs: GuardInputs) -> Array | None:
        """Update the mode; return torques, (na,) in N·m, or None."""
        deadline = self.deadline(inputs)
        if inputs.command_at > self._command_at or not (self.sending or self.mode is GuardMode.RELEASED):
            self._command_at = inputs.command_at
            self.reason = ""
            if not (now >= deadline):
                self._enter(GuardMode.IDLE if deadline == math.inf else GuardMode.WATCHING, now)
                return None
            self._take_over(now, inputs)
        if self.mode is GuardMode.DAMPING and not (now - self._since < self.limits.damping_time):
            self._enter(GuardMode.ZERO, now)
        if self.mode is GuardMode.ZERO and not (now - self._since < ZERO_TIME) and not self._tau.any():
            self._enter(GuardMode.RELEASED, now)
        return self._torques(now, inputs) if self.sending else None

    def velocity_is_stale(self, now: float, inputs: GuardInputs) -> bool:
        """Return True without fresh velocities for damping."""
        fresh = now - inputs.velocity_at <= self.limits.state_timeout
        return inputs.velocity is None or not fresh or not np.isfinite(inputs.velocity).all()

    def _take_over(self, now: float, inputs: GuardInputs) -> None:
        silence = now - inputs.command_at
        self.reason = f"COMMANDS_STOPPED: the last command came {1e3 * silence:.0f} ms ago"
        if inputs.mode is not None:
            self.reason += f", in mode {inputs.mode.value}"
        self.takeovers += 1
        limits = self.limits
        usable = np.isfinite(inputs.torques).all()
        self._tau = np.clip(inputs.torques, -limits.effort, limits.effort) if usable else np.zeros(len(limits.effort))
        self._tau_at = inputs.command_at
        self._enter(GuardMode.DAMPING, now)

    def _enter(self, mode: GuardMode, now: float) -> None:
        if mode is not self.mode:
            self.mode, self._since = mode, now

    def _torques(self, now: float, inputs: GuardInputs) -> Array:
        limits = self.limits
        wanted = np.zeros(len(limits.effort))
        if self.mode is GuardMode.DAMPING and inputs.velocity is not None and not self.velocity_is_stale(now, inputs):
            wanted = np.clip(-(limits.damping @ inputs.velocity), -limits.damping_torque, limits.damping_torque)
        step = limits.torque_rate * max(0.0, min(now - self._tau_at, limits.period))
        self._tau, self._tau_at = np.clip(wanted, self._tau - step, self._tau + step), now
        return frozen(self._tau)
