"""Monitors of the outputs, the log and the true fall of a robot in lockstep, for violated guarantees."""

import contextlib
import logging
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from wbc_controller.controller.report import CycleReport
from wbc_controller.errors import InputRefused
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.middleware.codec import decode
from wbc_controller.middleware.topics import counterpart
from wbc_controller.middleware.transports.memory import MemoryTransport
from wbc_controller.nodes.lockstep import Lockstep
from wbc_controller.records import IN_CONTROL, Array, Mode
from wbc_controller.safety.bring_up import UNEXPLAINED_MOTION
from wbc_controller.settings import Settings

_ROUNDING, _SAME_TIME = 1.0e-9, 1.0e-6  # rounding tolerance: share of a limit, and time, s
STALL = 0.02  # largest processor time of a cycle, s
ZEROS_AT_ONCE = ("ESTOP", UNEXPLAINED_MOTION)  # faults that send zero torques at once, without a rate
#: Latency that looks like a slow clock without synchronized clocks (docs/safety.md, the age of a state): share of the
#: elapsed time, and maximum between two messages, s.
_SLOW_CLOCK, _GAP = 0.5, 0.025
#: Tilt of a fallen base, rad, and its height above the lowest foot as a share of the initial height.
_TILT, _HEIGHT = math.radians(75.0), 0.3
MAX_FALLEN_TIME = 0.2  # with an active controller, s


@contextlib.contextmanager
def logged_errors() -> Iterator[list[str]]:
    """Collect the logged errors of this package, and print nothing."""
    logger, errors = logging.getLogger("wbc_controller"), list[str]()

    def emit(record: logging.LogRecord) -> None:
        error = record.exc_info[1] if record.exc_info else None
        errors.append(f"{record.getMessage()}: {type(error).__name__}: {error}")

    handler = logging.Handler(logging.ERROR)
    handler.emit = emit  # type: ignore[method-assign]
    level, propagate = logger.level, logger.propagate
    logger.addHandler(handler)
    logger.setLevel(logging.ERROR)
    logger.propagate = False
    try:
        yield errors
    finally:
        logger.propagate = propagate
        logger.setLevel(level)
        logger.removeHandler(handler)


class OutputMonitor:
    """Checks every torque message and the report of every cycle."""

    def __init__(
        self, model: RobotModel, settings: Settings, names: Mapping[str, str], *, stamps_lie: bool = False
    ) -> None:
        """Start; `names` are the topics of the state's streams, `stamps_lie` permits advanced stamps."""
        self.now = 0.0  # true simulated time, s; set by the trial
        self.violations: dict[str, str] = {}  # text of the first violation of each kind
        self.mode: Mode | None = None
        self.deactivation: tuple[float, str, str] | None = None  # end of the active mode: time, fault code and text
        self.longest = 0.0  # longest processor time of a cycle, s
        self._model, self._settings, self._limits = model, settings, model.effort_limits
        self._period = 1.0 / settings.control.rate
        self._timeout = settings.safety.state_timeout + (settings.safety.clock_tolerance if stamps_lie else 0.0)
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
        size = self._model.actuation.command_size
        if values.shape != (size,):
            self.add_violation("unreadable", f"{values.size} torques; required: {size}")
            return
        if not np.isfinite(values).all():
            self.add_violation("not_finite", f"{values}")
            return
        tau = self._model.actuation.from_command(values)
        over = np.abs(tau) > self._limits * (1.0 + _ROUNDING)
        if over.any():
            self.add_violation("over_limit", self._named(over, tau, self._limits))
        elapsed = min(max(self.now - self._tau_time, 0.0), self._period)
        step = self._settings.limits.torque_rate * self._limits * elapsed
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
        if self.deactivation is None and self.mode in IN_CONTROL and report.mode not in IN_CONTROL:
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
            hidden_latency = 0.0 if self._settings.safety.synchronized_clocks else used.hidden_latency
            if not age - hidden_latency <= self._timeout + _SAME_TIME:
                old[stream] = age
        increased = (np.abs(self._tau) > np.abs(self._previous_tau) + _ROUNDING * self._limits).any()
        if report.solution is not None and old and self._tau.any():
            self.add_violation("stale", "torques computed from " + _ages_text(old))
        elif "joint_states" in old and increased:
            self.add_violation("stale", "torques increased by damping with " + _ages_text(old))

    def _named(self, violated: np.ndarray, values: Array, limits: Array) -> str:
        at = int(np.flatnonzero(violated)[0])
        return f"{self._model.actuators[at]}: {values[at]:.6g} N·m (limit {limits[at]:.6g})"


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
        self.hidden_latency = min(now - measured_at, self.hidden_latency + growth)
        self.measured_at, self._arrived_at = measured_at, now


def _ages_text(ages: Mapping[str, float]) -> str:
    return ", ".join(f"{stream}, true age {1e3 * age:.0f} ms" for stream, age in ages.items())


class MonitoredRobot(Lockstep):
    """Controller and mock robot, with its `monitor` and the detection of a fall from the true state."""

    def __init__(
        self, settings: Settings, *observers: Callable[[CycleReport], None], stamps_lie: bool, **options: Any
    ) -> None:
        """Build a robot on its hoist; `stamps_lie` as for `OutputMonitor`, `options` as for `Lockstep`."""
        super().__init__(settings, observers=observers, **options)
        streams = ("joint_states", "odom") if self.model.floating_base else ("joint_states",)
        topics = {topic.key: topic for topic in self.topics}
        names = {stream: topics[stream].name for stream in streams}
        self.monitor = OutputMonitor(self.model, settings, names, stamps_lie=stamps_lie)
        self.loop.observers = (self.monitor.cycle, *self.loop.observers)
        self.mock.sent = self.monitor.sent
        MemoryTransport(self.bus).subscribe(counterpart(topics["effort"]), self.monitor.torques)
        self._initial_height, self._fallen_since = self._height_above_feet(), math.inf

    def publish_state(self) -> None:
        """See `Lockstep`."""
        self.monitor.now = 1.0e-9 * self.mock.stamp
        super().publish_state()

    def stays_fallen(self) -> bool:
        """Return True if the robot has lain on the ground in all calls for `MAX_FALLEN_TIME`."""
        self._fallen_since = min(self._fallen_since, self.time) if self.has_fallen() else math.inf
        return self.time - self._fallen_since > MAX_FALLEN_TIME

    def has_fallen(self) -> bool:
        """Return True if the robot lies on the ground."""
        if not self.model.floating_base:
            return False
        x, y = self.mock.plant.state()[0][3:5].tolist()
        upright = 1.0 - 2.0 * (x * x + y * y) >= math.cos(_TILT)
        return not (upright and self._height_above_feet() >= _HEIGHT * self._initial_height)

    def _height_above_feet(self) -> float:
        plant = self.mock.plant
        if not (self.model.floating_base and plant.contacts):
            return math.inf
        feet = [float(plant.foot_placement(name).translation[2]) for name in plant.contacts]
        return float(plant.state()[0][2]) - min(feet)
