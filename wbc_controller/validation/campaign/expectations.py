"""Expected outcome of each kind of fault: survival, detection in time, or damping for a valid reason."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from wbc_controller.safety.plausibility import MEMORY
from wbc_controller.safety.sample_plausibility import SEQUENCE
from wbc_controller.settings import Settings
from wbc_controller.simulation.faults.fault import Fault

#: Valid fault codes for a robot that loses its balance or gets false inputs.
BALANCE = frozenset({"FALLEN", "NO_SOLUTION", "RELAXED", "BAD_TORQUE", "IMPLAUSIBLE_STATE", "ESTIMATE_LOST"})
STALE = frozenset({"STALE_INPUT"})
IMPLAUSIBLE = frozenset({"IMPLAUSIBLE_STATE"})
CLOCK = frozenset({"CLOCK"})
#: Factor by which a threshold must be exceeded for certain detection, because the robot moves.
_MARGIN = 1.1
#: Probability below which a random event is excluded.
_NEVER = 1.0e-6


@dataclass(frozen=True, slots=True)
class Expectation:
    """Expected outcome of a fault."""

    codes: frozenset[str]  # valid fault codes; empty if the robot must survive
    # time limit of the damping after the beginning of the fault, s; None if the robot may survive
    deadline: float | None = None

    @property
    def word(self) -> str:
        """Label in tables."""
        return "survive" if not self.codes else "either" if self.deadline is None else "detect"


HARMLESS = Expectation(frozenset())
EITHER = Expectation(BALANCE)
STALE_OR_BALANCE = Expectation(STALE | BALANCE)

#: Returns the expected outcome of a fault.
_Rule = Callable[[Any, "Known"], Expectation]


@dataclass(frozen=True, slots=True)
class Known:
    """Settings and times for the rules."""

    settings: Settings
    cycle: float  # two control periods, for begin and detection of a fault, s
    timeout: float  # `safety.state_timeout`, s

    @property
    def sequence(self) -> float:
        """Duration of a sequence of implausible samples that is a fault, s."""
        return 0.5 * (SEQUENCE - 1) * self.cycle

    def refused(self, lasts: float, after: float = 0.0) -> Expectation:
        """Return the outcome of messages that are missing or refused for a time, s, from `after` on."""
        if lasts <= self.timeout + self.cycle:
            return STALE_OR_BALANCE
        return Expectation(STALE | BALANCE, after + self.timeout + self.cycle)

    def seen(self, sure: bool, deadline: float, codes: frozenset[str] = IMPLAUSIBLE) -> Expectation:
        """Return the outcome of a fault that is detected for sure, or that may be survived."""
        return Expectation(codes | BALANCE, deadline + self.cycle) if sure else Expectation(codes | BALANCE)


def expect(fault: Fault, settings: Settings) -> Expectation:
    """Return the expected outcome of a fault."""
    period = 1.0 / settings.control.rate
    known = Known(settings, 2.0 * period, settings.safety.state_timeout)
    return RULES[fault.kind()](fault, known)


def _ramped(value: float, ramp: float, lasts: float, threshold: float) -> bool:
    """Return True if the mismatch of a value ramped to `value` exceeds a threshold, with the filter's decay."""
    grown = min(ramp, lasts)
    peak = abs(value) if ramp == 0.0 else abs(value) / ramp * MEMORY * (1.0 - np.exp(-grown / MEMORY))
    return peak > _MARGIN * threshold


def _drifting(rate: float, lasts: float, threshold: float) -> float | None:
    """Return the time until the mismatch of a steady drift exceeds a threshold, s, or None."""
    share = _MARGIN * threshold / (rate * MEMORY)
    time = -MEMORY * float(np.log(1.0 - share)) if share < 1.0 else np.inf
    return time if time < lasts else None


def _spike(fault: Any, known: Known) -> Expectation:
    """Return the rule's outcome: single implausible samples are rejected, a sequence is a fault."""
    messages = np.ceil(np.log(_NEVER) / np.log(1.0 - fault.share**SEQUENCE))
    surely = float(messages) * 0.5 * SEQUENCE * known.cycle
    large = fault.size > _MARGIN * known.settings.safety.joint_mismatch
    return known.seen(large and surely < fault.duration, surely)


def _share_refused(fault: Any, known: Known) -> Expectation:
    """A share of the messages of a stream is missing or refused."""
    return known.refused(fault.duration) if fault.share == 1.0 else STALE_OR_BALANCE


def _lost(fault: Any, known: Known) -> Expectation:
    if fault.stream == "imu" or fault.share <= 0.1:
        return HARMLESS
    return _share_refused(fault, known)


def _absent(fault: Any, known: Known) -> Expectation:
    """All messages of a stream are missing for the duration."""
    return HARMLESS if getattr(fault, "stream", "") == "imu" else known.refused(fault.duration)


def _delayed_ever_more(fault: Any, known: Known) -> Expectation:
    """Without synchronized clocks, a growing delay looks like a slow clock."""
    seen = fault.growth if known.settings.safety.synchronized_clocks else fault.growth - 1.0
    if seen <= 0.0:
        return STALE_OR_BALANCE
    too_old = known.timeout / seen * (1.0 + fault.growth)  # arrival of the first message detected as too old
    if too_old + known.timeout + known.cycle >= fault.duration:
        return STALE_OR_BALANCE
    return Expectation(STALE | BALANCE, too_old + known.timeout + known.cycle)


def _jumped_ahead(fault: Any, known: Known) -> Expectation:
    safety = known.settings.safety
    refused = _MARGIN * safety.clock_tolerance if safety.synchronized_clocks else _FAR_AHEAD
    return known.refused(fault.duration) if fault.by > refused else STALE_OR_BALANCE


def _clock(fault: Any, known: Known) -> Expectation:
    if fault.by < 0.0:
        return known.seen(True, 0.0, CLOCK)
    return known.seen(fault.by > _MARGIN * known.timeout, known.timeout, STALE | CLOCK)


def _no_stream(rule: _Rule) -> _Rule:
    """Faults of the IMU are harmless: the controller does not read it."""
    return lambda fault, known: HARMLESS if fault.stream == "imu" else rule(fault, known)


def _no_longer_than(key: str) -> _Rule:
    """Messages are refused for the time in a parameter, at most for the duration."""
    return lambda fault, known: known.refused(min(getattr(fault, key), fault.duration))


def _small(limits: Mapping[str, float], otherwise: Expectation = EITHER) -> _Rule:
    """Harmless if each parameter is within its limit."""
    return lambda fault, known: (
        HARMLESS if all(abs(getattr(fault, key)) <= limit for key, limit in limits.items()) else otherwise
    )


def _always(expectation: Expectation) -> _Rule:
    return lambda fault, known: expectation


def _jump(key: str, threshold: str, share: float = 1.0) -> _Rule:
    """A jump by a parameter, with a share along one axis, compared with a threshold of `safety`."""
    return lambda fault, known: known.seen(
        share * getattr(fault, key) > _MARGIN * getattr(known.settings.safety, threshold), known.sequence
    )


def _drift(key: str, threshold: str, share: float = 1.0) -> _Rule:
    def rule(fault: Any, known: Known) -> Expectation:
        limit = getattr(known.settings.safety, threshold)
        time = _drifting(share * getattr(fault, key), fault.duration, limit)
        if time is not None:
            return known.seen(True, time)
        return HARMLESS if getattr(fault, key) <= _SLOW_DRIFT else EITHER

    return rule


def _ramp(key: str, threshold: str, share: float = 1.0) -> _Rule:
    def rule(fault: Any, known: Known) -> Expectation:
        limit = getattr(known.settings.safety, threshold)
        sure = _ramped(share * getattr(fault, key), fault.ramp, fault.duration, limit)
        return known.seen(sure, min(fault.ramp, fault.duration) + known.sequence)

    return rule


def _frozen(fault: Any, known: Known) -> Expectation:
    safety = known.settings.safety
    lasts = max(safety.frozen_time, safety.state_timeout) + known.cycle
    return known.seen(fault.duration > lasts, lasts)


#: Advance of a refused stamp without synchronized clocks, s (middleware/stamps.py).
_FAR_AHEAD = 0.26
#: Drift of odometry that a standing robot can follow, m/s or rad/s.
_SLOW_DRIFT = 0.01
#: Smallest share of a random horizontal direction along one of two axes.
_ALONG = float(np.sqrt(0.5))

_EITHER, _SURVIVES = _always(EITHER), _always(HARMLESS)


def _estop(fault: Any, known: Known) -> Expectation:
    return Expectation(frozenset({"ESTOP"}), known.cycle)


RULES: Mapping[str, _Rule] = {
    "joint_noise": _small({"sigma": 1e-4, "velocity_sigma": 1e-3}),
    "joint_bias": _ramp("bias", "joint_mismatch"),
    "joint_scale": _EITHER,
    "joint_quantization": _small({"step": 2e-4}),
    "joint_lag": _EITHER,
    "joint_spike": _spike,
    "joint_jump": _jump("size", "joint_mismatch"),
    "joint_frozen": _EITHER,
    "joint_states_frozen": _frozen,
    "joint_not_a_number": _share_refused,
    "joint_absurd": lambda fault, known: known.seen(True, known.sequence),
    "joint_missing": _absent,
    "joints_swapped": _EITHER,
    "velocity_lag": _small({"time_constant": 0.002}),
    "velocity_sign": _EITHER,
    "velocity_dead": _EITHER,
    "odom_noise": _small({"sigma": 1e-4, "turn_sigma": 1e-4}),
    "odom_velocity_noise": _small({"sigma": 1e-3}),
    "odom_drift": _drift("speed", "base_mismatch", _ALONG),
    "odom_turn_drift": _drift("rate", "base_turn_mismatch"),
    "odom_jump": _jump("size", "base_mismatch", _ALONG),
    "odom_turn_jump": _jump("angle", "base_turn_mismatch"),
    "odom_tilt": _ramp("angle", "base_turn_mismatch", _ALONG),
    "odom_frozen": _frozen,
    "odom_lag": _small({"time_constant": 0.002}),
    "odom_slow": _no_longer_than("period"),
    "odom_bad_quaternion": _absent,
    "odom_not_a_number": _share_refused,
    "odom_absurd": lambda fault, known: known.seen(True, known.sequence),
    "odom_wrong_frame": _absent,
    "imu_noise": _SURVIVES,
    "imu_bias": _SURVIVES,
    "imu_shock": _SURVIVES,
    "message_delay": _no_stream(_no_longer_than("delay")),
    "message_growing_delay": _no_stream(_delayed_ever_more),
    "message_jitter": _no_stream(_always(STALE_OR_BALANCE)),
    "message_loss": _lost,
    "message_dropout": _absent,
    "message_duplication": _SURVIVES,
    "message_reordering": _no_stream(_always(STALE_OR_BALANCE)),
    "message_replay": _no_stream(lambda fault, known: known.refused(fault.duration - fault.length, fault.length)),
    "message_queue": _absent,
    "command_loss": _small({"share": 0.02}),
    "command_delay": _EITHER,
    "command_twice": _SURVIVES,
    "stamp_zero": _absent,
    "stamp_frozen": _absent,
    "stamp_back": _no_longer_than("by"),
    "stamp_ahead": _jumped_ahead,
    "stamp_drift": _small({"rate": 1e-3}, STALE_OR_BALANCE),
    "clock_jump": _clock,
    "clock_frozen": lambda fault, known: known.seen(
        fault.duration > known.timeout + known.cycle, known.timeout, STALE | CLOCK
    ),
    "clock_drift": _always(Expectation(STALE | CLOCK | BALANCE)),
    "actuator_dead": _EITHER,
    "actuator_reversed": _EITHER,
    "actuator_gain": _EITHER,
    "actuator_weak": _EITHER,
    "actuator_bias": _small({"share": 0.005}),
    "actuator_noise": _small({"share": 0.002}),
    "actuator_lag": _small({"time_constant": 0.001}),
    "actuator_delay": _EITHER,
    "joint_friction": _EITHER,
    "joint_locked": _EITHER,
    "payload": _EITHER,
    "mass_error": _small({"share": 0.02}),
    "center_of_mass_error": _small({"offset": 0.005}),
    "slippery_floor": _EITHER,
    "soft_floor": _EITHER,
    "floor_drop": _EITHER,
    "floor_hole": _EITHER,
    "floor_tilt": _small({"angle": 0.01}),
    "push": _small({"share": 0.01}),
    "kick": _small({"speed": 0.03}),
    "garbage": _SURVIVES,
    "unknown_words": _SURVIVES,
    "request_flood": _SURVIVES,
    "far_setpoint": _EITHER,
    "step_setpoint": _EITHER,
    "long_trajectory": _SURVIVES,
    "huge_message": _SURVIVES,
    "estop": _estop,
    "estop_in_flood": _estop,
    "contact_off": _EITHER,
    "conflicting_updates": _EITHER,
}
