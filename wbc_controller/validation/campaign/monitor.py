"""Checks the controller's outputs in a trial for violations that no fault may cause."""

import math
from collections.abc import Mapping

import numpy as np

from wbc_controller.controller.report import CycleReport
from wbc_controller.errors import InputRefused
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware.codec import decode
from wbc_controller.records import Array, Mode
from wbc_controller.settings import Settings

#: Rounding that is no violation: a share of a limit, and a time in s.
_ROUNDING, _SAME_TIME = 1.0e-9, 1.0e-6
#: Longest processor time of the loop for one cycle, s.
STALL = 0.02
#: Modes in which torques are computed from a solution, or were.
_IN_CONTROL = (Mode.ACTIVE, Mode.HOLDING)
#: Latency that clocks which are not synchronized cannot tell from a slow clock (docs/safety.md, the age of a state): as
#: a share of the time that passes, and at most in a gap between two messages, s.
_SLOW_CLOCK, _GAP = 0.5, 0.025
#: Every name of a violation that `OutputMonitor` can find, with its meaning.
VIOLATIONS: Mapping[str, str] = {
    "unreadable": "a message with torques that cannot be read, or of another size",
    "not_finite": "a torque that is not finite",
    "over_limit": "a torque over its effort limit",
    "over_rate": "a torque that changed faster than limits.torque_rate",
    "stale": "torques computed from, or damping with, a state that was truly older than safety.state_timeout",
    "internal_error": "the fault INTERNAL_ERROR",
    "stall": f"more than {1e3 * STALL:.0f} ms of processor time of the loop in one cycle",
    "logged": "an exception in the log",
}


class OutputMonitor:
    """Checks every message with torques, and the report of every cycle.

    Attributes:
        now: true simulated time, s; set by the trial.
        violations: a sentence for the first of each kind, by name.
        mode: mode after the last cycle; None before the first.
        left: when the controller left its active mode, with the code and the sentence of the fault.
        longest: longest processor time of the loop for one cycle, s.
    """

    def __init__(
        self, model: RobotModel, settings: Settings, names: Mapping[str, str], *, stamps_lie: bool = False
    ) -> None:
        """Name the topic of each stream of the state; `stamps_lie` if stamps may be ahead by the tolerated time."""
        self.now = 0.0
        self.violations: dict[str, str] = {}
        self.mode: Mode | None = None
        self.left: tuple[float, str, str] | None = None
        self.longest = 0.0
        self._actuators, self._limits = model.actuators, model.effort_limits
        self._read_command = model.actuation.from_command
        self._size = model.actuation.command_size
        self._rate = settings.limits.torque_rate
        self._period = 1.0 / settings.control.rate
        self._timeout = settings.safety.state_timeout + (settings.safety.clock_tolerance if stamps_lie else 0.0)
        self._synchronized = settings.safety.synchronized_clocks
        self._topics = dict(names)
        self._sent: dict[str, int] = {}  # true time of the newest message since the last cycle, ns, by stream
        self._used = {name: _Used() for name in names}  # the newest that was not refused
        self._tau, self._tau_time = np.zeros(model.na), -math.inf
        self._since = np.zeros(model.na)  # torques before this cycle
        self._too_fast: str | None = None

    def found(self, name: str, sentence: str) -> None:
        """Note a violation; of each kind the first is kept."""
        self.violations.setdefault(name, f"at {self.now:.3f} s: {sentence}")

    def sent(self, stream: str, taken: int) -> None:
        """Note a delivered message of the robot, with the true time of its measurement, ns."""
        if stream in self._topics:
            self._sent[stream] = taken

    def torques(self, payload: bytes) -> None:
        """Check one message with torques."""
        try:
            values = np.array(decode(payload, "std_msgs/msg/Float64MultiArray").data, dtype=np.float64)
        except InputRefused as error:
            self.found("unreadable", str(error))
            return
        if values.shape != (self._size,):
            self.found("unreadable", f"{values.size} torques; {self._size} expected")
            return
        if not np.isfinite(values).all():
            self.found("not_finite", f"{values}")
            return
        tau = self._read_command(values)
        over = np.abs(tau) > self._limits * (1.0 + _ROUNDING)
        if over.any():
            self.found("over_limit", self._named(over, tau, self._limits))
        elapsed = min(max(self.now - self._tau_time, 0.0), self._period)
        step = self._rate * self._limits * elapsed
        fast = np.abs(tau - self._tau) > step + _ROUNDING * self._limits
        if fast.any():
            self._too_fast = self._named(fast, tau - self._tau, step)
        self._since = self._tau
        self._tau, self._tau_time = tau, self.now

    def cycle(self, report: CycleReport) -> None:
        """Check the report of one cycle, whose torques have been checked before."""
        code = report.fault.code if report.fault is not None else ""
        if self._too_fast is not None and not (code == "ESTOP" and not self._tau.any()):
            self.found("over_rate", self._too_fast)
        self._too_fast = None
        for stream, taken in self._sent.items():
            name = f"{self._topics[stream]}: "
            if not any(sentence.startswith(name) for sentence in report.refused):
                self._used[stream].renew(1.0e-9 * taken, self.now)
        self._sent.clear()
        if report.command is not None:
            self._age(report)
        if code == "INTERNAL_ERROR" and report.fault is not None:
            self.found("internal_error", report.fault.sentence)
        if self.left is None and self.mode in _IN_CONTROL and report.mode not in _IN_CONTROL:
            self.left = self.now, code or report.mode.value, report.fault.sentence if report.fault else ""
        self.mode = report.mode

    def spent(self, seconds: float) -> None:
        """Check the loop's own processor time for one cycle, s."""
        self.longest = max(self.longest, seconds)
        if seconds > STALL:
            self.found("stall", f"{1e3 * seconds:.1f} ms")

    def _age(self, report: CycleReport) -> None:
        """Check the true age of the state from which the torques were computed."""
        old = {}
        for stream, used in self._used.items():
            age = self.now - used.taken
            unseen = 0.0 if self._synchronized else used.unseen
            if not age - unseen <= self._timeout + _SAME_TIME:
                old[stream] = age
        if report.solution is not None and old and self._tau.any():
            self.found("stale", "torques were computed from " + _said(old))
        elif "joint_states" in old and (np.abs(self._tau) > np.abs(self._since) + _ROUNDING * self._limits).any():
            self.found("stale", "torques rose by damping with " + _said(old))

    def _named(self, wrong: np.ndarray, values: Array, limits: Array) -> str:
        at = int(np.flatnonzero(wrong)[0])
        return f"{self._actuators[at]}: {values[at]:.6g} N·m (limit {limits[at]:.6g})"


class _Used:
    """The newest used message of a stream.

    Attributes:
        taken: true time of the measurement, s.
        unseen: latency that clocks which are not synchronized cannot tell from an offset, s: what is constant, and
            what looks like a slow clock.
    """

    def __init__(self) -> None:
        self.taken = -math.inf
        self.unseen = math.inf
        self._came, self._may_grow = -math.inf, 0.0

    def renew(self, taken: float, now: float) -> None:
        """Take another message."""
        self._may_grow = min(self._may_grow + _SLOW_CLOCK * (now - self._came), _GAP)
        growth = min(max(taken - self.taken, 0.0), self._may_grow)
        self._may_grow -= growth
        self.taken, self.unseen, self._came = taken, min(now - taken, self.unseen + growth), now


def _said(ages: Mapping[str, float]) -> str:
    return ", ".join(f"{stream} truly {1e3 * age:.0f} ms old" for stream, age in ages.items())
