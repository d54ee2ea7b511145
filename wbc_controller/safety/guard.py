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
from wbc_controller.settings import Settings

#: Modes in which the controller may stop commanding after zero torques.
_ENDED = (Mode.INACTIVE, Mode.STOPPED, Mode.FAULT)
ZERO_TIME = 1.0  # duration of zero torques before the guard stops sending, s


class GuardMode(str, enum.Enum):
    """Mode of the guard."""

    IDLE = "idle"
    WATCHING = "watching"
    DAMPING = "damping"
    ZERO = "zero"
    RELEASED = "released"


@dataclass(frozen=True, slots=True)
class GuardInputs:
    """Latched messages of the guard; times are arrival times on its clock."""

    command_at: float  # newest command, s; -inf without any
    torques: Array  # newest command, (na,) in N·m
    unanswered_at: float  # first joint state after the newest command, s; inf without any
    mode: Mode | None  # last reported mode of the controller, or None
    velocity: Array | None  # newest joint velocities, (nj,) in rad/s, or None
    velocity_at: float  # newest joint velocities, s
    command_stamp: int = 0  # of the newest command, ns


class Guard:
    """Decides when the guard sends torques, and which; `reason` explains a takeover."""

    def __init__(self, settings: Settings, effort: Array, damping: Array) -> None:
        """Torques -K v of the `damping` K, (na, nj), and limits `effort`, (na,) in N·m."""
        self.mode = GuardMode.IDLE
        self.reason = ""
        self.takeovers = 0
        self._settings, self._effort, self._damping = settings.guard, effort, damping
        self._damping_torque = settings.guard.torque * effort
        self._torque_rate = settings.limits.torque_rate * effort
        self._period = 1.0 / settings.control.rate
        self._triggered = settings.control.trigger == "joint_states"
        # of velocities for damping, and of joint states for a triggered controller, s
        self._state_timeout = settings.safety.state_timeout
        self._since = 0.0  # start of the present mode, s
        self._command_at = -math.inf  # arrival of the newest processed command, s
        self._tau = np.zeros(len(effort))  # last torques on the topic
        self._tau_at = -math.inf  # their time, s

    @property
    def sending(self) -> bool:
        """True if the guard sends torques."""
        return self.mode in (GuardMode.DAMPING, GuardMode.ZERO)

    def deadline(self, inputs: GuardInputs) -> float:
        """Return the time of the takeover without a new command, s, or inf."""
        if inputs.command_at == -math.inf or (inputs.mode in _ENDED and not inputs.torques.any()):
            return math.inf
        due = inputs.command_at + self._period
        if self._triggered:
            due = min(inputs.unanswered_at, due + self._state_timeout)
        return due + self._settings.patience

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
        if self.mode is GuardMode.DAMPING and not (now - self._since < self._settings.damping_time):
            self._enter(GuardMode.ZERO, now)
        if self.mode is GuardMode.ZERO and not (now - self._since < ZERO_TIME) and not self._tau.any():
            self._enter(GuardMode.RELEASED, now)
        return self._torques(now, inputs) if self.sending else None

    def velocity_is_stale(self, now: float, inputs: GuardInputs) -> bool:
        """Return True without fresh velocities for damping."""
        fresh = now - inputs.velocity_at <= self._state_timeout
        return inputs.velocity is None or not fresh or not np.isfinite(inputs.velocity).all()

    def _take_over(self, now: float, inputs: GuardInputs) -> None:
        self.reason = f"COMMANDS_STOPPED: the last command came {1e3 * (now - inputs.command_at):.0f} ms ago"
        if inputs.mode is not None:
            self.reason += f", in mode {inputs.mode.value}"
        self.takeovers += 1
        usable = np.isfinite(inputs.torques).all()
        self._tau = np.clip(inputs.torques, -self._effort, self._effort) if usable else np.zeros(len(self._effort))
        self._tau_at = inputs.command_at
        self._enter(GuardMode.DAMPING, now)

    def _enter(self, mode: GuardMode, now: float) -> None:
        if mode is not self.mode:
            self.mode, self._since = mode, now

    def _torques(self, now: float, inputs: GuardInputs) -> Array:
        wanted = np.zeros(len(self._effort))
        if self.mode is GuardMode.DAMPING and inputs.velocity is not None and not self.velocity_is_stale(now, inputs):
            wanted = np.clip(-(self._damping @ inputs.velocity), -self._damping_torque, self._damping_torque)
        step = self._torque_rate * max(0.0, min(now - self._tau_at, self._period))
        self._tau, self._tau_at = np.clip(wanted, self._tau - step, self._tau + step), now
        return frozen(self._tau)
