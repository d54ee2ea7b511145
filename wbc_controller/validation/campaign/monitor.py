"""Monitor of the outputs for violated guarantees."""

import math
from collections.abc import Mapping

import numpy as np

from wbc_controller.controller.report import CycleReport
from wbc_controller.errors import InputRefused
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware.codec import decode
from wbc_controller.records import Array, Mode
from wbc_controller.safety.bring_up import UNEXPLAINED_MOTION
from wbc_controller.settings import Settings

_ROUNDING, _SAME_TIME = 1.0e-9, 1.0e-6  # rounding tolerance: share of a limit, and time, s
STALL = 0.02  # largest processor time of a cycle, s
#: Faults that send zero torques at once, without a rate.
ZEROS_AT_ONCE = ("ESTOP", UNEXPLAINED_MOTION)
_IN_CONTROL = (Mode.ACTIVE, Mode.HOLDING)  # modes with torques from a solution
#: Latency that looks like a slow clock without synchronized clocks (docs/safety.md, the age of a state): share of the
#: elapsed time, and maximum between two messages, s.
_SLOW_CLOCK, _GAP = 0.5, 0.025


class OutputMonitor:
    """Checks every torque message and the report of every cycle.

    Attributes:
        now: true simulated time, s; set by the trial.
        violations: text of the first violation of each kind.
        deactivation: end of the active mode: time, fault code and text.
        longest: longest processor time of a cycle, s.
    """

    def __init__(
        self, model: RobotModel, settings: Settings, names: Mapping[str, str], *, stamps_lie: bool = False
    ) -> None:
        """Start; `names` are the topics of the state's streams, `stamps_lie` permits advanced stamps."""
        self.now = 0.0
        self.violations: dict[str, str] = {}
        self.mode: Mode | None = None
        self.deactivation: tuple[float, str, str] | None = None
        self.longest = 0.0
        self._actuators, self._limits = model.actuators, model.effort_limits
        self._read_command = model.actuation.from_command
        self._size = model.actuation.command_size
        self._rate = settings.limits.torque_rate
        self._period = 1.0 / settings.control.rate
        self._timeout = settings.safety.state_timeout + (settings.safety.clock_tolerance if stamps_lie else 0.0)
        self._synchronized = settings.safety.synchronized_clocks
        self._topics = dict(names)
        self._delivered: dict[str, int] = {}  # true time of the newest message, ns, by stream
        self._used = {name: _AcceptedMessage() for name in names}  # newest accepted message
        self._tau, self._tau_time = np.zeros(model.na), -math.inf
        self._previous_tau = np.zeros(model.na)  # torques before this cycle
        self._too_fast: str | None = None

    def add_violation(self, name: str, sentence: str) -> None:
        """Store the first violation of each kind."""
        self.violations.setdefault(name, f"at {self.now:.3f} s: {sentence}")

    def sent(self, stream: str, measured_at: int) -> None:
        """Store a delivered message, with the true time of its measurement, ns."""
        if stream in self._topics:
            self._delivered[stream] = measured_at

    def torques(self, payload: bytes) -> None:
        """Check one torque message."""
        try:
            values = np.array(decode(payload, "std_msgs/msg/Float64MultiArray").data, dtype=np.float64)
        except InputRefused as error:
            self.add_violation("unreadable", str(error))
            return
        if values.shape != (self._size,):
            self.add_violation("unreadable", f"{values.size} torques; required: {self._size}")
            return
        if not np.isfinite(values).all():
            self.add_violation("not_finite", f"{values}")
            return
        tau = self._read_command(values)
        over = np.abs(tau) > self._limits * (1.0 + _ROUNDING)
        if over.any():
            self.add_violation("over_limit", self._named(over, tau, self._limits))
        elapsed = min(max(self.now - self._tau_time, 0.0), self._period)
        step = self._rate * self._limits * elapsed
        fast = np.abs(tau - self._tau) > step + _ROUNDING * self._limits
        if fast.any():
            self._too_fast = self._named(fast, tau - self._tau, step)
        self._previous_tau = self._tau
        self._tau, self._tau_time = tau, self.now

    def cycle(self, report: CycleReport) -> None:
        """Check a report, after its torques."""
        code = report.fault.code if report.fault is not None else ""
        at_once = code in ZEROS_AT_ONCE and not self._tau.any()
        if self._too_fast is not None and not at_once:
            self.add_violation("over_rate", self._too_fast)
        self._too_fast = None
        for stream, measured_at in self._delivered.items():
            name = f"{self._topics[stream]}: "
            if not any(sentence.startswith(name) for sentence in report.refused):
                self._used[stream].update(1.0e-9 * measured_at, self.now)
        self._delivered.clear()
        if report.command is not None:
            self._check_age(report)
        if code == "INTERNAL_ERROR" and report.fault is not None:
            self.add_violation("internal_error", report.fault.sentence)
        if self.deactivation is None and self.mode in _IN_CONTROL and report.mode not in _IN_CONTROL:
            self.deactivation = self.now, code or report.mode.value, report.fault.sentence if report.fault else ""
        self.mode = report.mode

    def check_processor_time(self, seconds: float) -> None:
        """Check the processor time of the loop for one cycle, s."""
        self.longest = max(self.longest, seconds)
        if seconds > STALL:
            self.add_violation("stall", f"{1e3 * seconds:.1f} ms")

    def _check_age(self, report: CycleReport) -> None:
        old = {}
        for stream, used in self._used.items():
            age = self.now - used.measured_at
            hidden_latency = 0.0 if self._synchronized else used.hidden_latency
            if not age - hidden_latency <= self._timeout + _SAME_TIME:
                old[stream] = age
        if report.solution is not None and old and self._tau.any():
            self.add_violation("stale", "torques computed from " + _ages_text(old))
        elif (
            "joint_states" in old and (np.abs(self._tau) > np.abs(self._previous_tau) + _ROUNDING * self._limits).any()
        ):
            self.add_violation("stale", "torques increased by damping with " + _ages_text(old))

    def _named(self, violated: np.ndarray, values: Array, limits: Array) -> str:
        at = int(np.flatnonzero(violated)[0])
        return f"{self._actuators[at]}: {values[at]:.6g} N·m (limit {limits[at]:.6g})"


class _AcceptedMessage:
    """Newest accepted message; `hidden_latency` looks like a clock offset or a slow clock, s."""

    def __init__(self) -> None:
        self.measured_at = -math.inf
        self.hidden_latency = math.inf
        self._arrived_at, self._may_grow = -math.inf, 0.0

    def update(self, measured_at: float, now: float) -> None:
        self._may_grow = min(self._may_grow + _SLOW_CLOCK * (now - self._arrived_at), _GAP)
        growth = min(max(measured_at - self.measured_at, 0.0), self._may_grow)
        self._may_grow -= growth
        self.measured_at, self.hidden_latency, self._arrived_at = (
            measured_at,
            min(now - measured_at, self.hidden_latency + growth),
            now,
        )


def _ages_text(ages: Mapping[str, float]) -> str:
    return ", ".join(f"{stream}, true age {1e3 * age:.0f} ms" for stream, age in ages.items())
