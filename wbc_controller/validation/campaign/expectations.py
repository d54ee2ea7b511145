"""Expected outcome of each kind of fault."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from wbc_controller.safety.plausibility import MEMORY
from wbc_controller.safety.sample_plausibility import SEQUENCE
from wbc_controller.settings import Settings
from wbc_controller.simulation.faults.fault import Fault

#: Valid fault codes for a robot that loses its balance or gets false inputs.
BALANCE = frozenset({"FALLEN", "FALLING", "NO_SOLUTION", "RELAXED", "BAD_TORQUE", "IMPLAUSIBLE_STATE", "ESTIMATE_LOST"})
STALE = frozenset({"STALE_INPUT"})
IMPLAUSIBLE = frozenset({"IMPLAUSIBLE_STATE"})
CLOCK = frozenset({"CLOCK"})
_MARGIN = 1.1  # excess over a threshold for certain detection
_NEGLIGIBLE = 1.0e-6  # probability


@dataclass(frozen=True, slots=True)
class Expectation:
    """Expected outcome of a fault."""

    codes: frozenset[str]  # valid fault codes; empty if the robot must survive
    deadline: float | None = None  # time limit of the damping after the fault's start, s; None if it may survive


HARMLESS = Expectation(frozenset())
EITHER = Expectation(BALANCE)
STALE_OR_BALANCE = Expectation(STALE | BALANCE)

_Rule = Callable[[Any, "RuleContext"], Expectation]  # returns the expected outcome of a fault by its parameters


@dataclass(frozen=True, slots=True)
class RuleContext:
    """Settings and times for the rules."""

    settings: Settings
    cycle: float  # two control periods, s
    timeout: float  # `safety.state_timeout`, s

    @property
    def sequence(self) -> float:
        """Shortest duration of implausible samples for a fault, s."""
        return 0.5 * (SEQUENCE - 1) * self.cycle

    def exceeded(self, threshold: str) -> float:
        """Return a value that certainly exceeds a threshold of `safety`."""
        return float(_MARGIN * getattr(self.settings.safety, threshold))

    def expect_stale(self, lasts: float, after: float = 0.0) -> Expectation:
        """Return the outcome of messages that are missing or refused for a time, s, from `after` on."""
        return self.expect_detection(lasts > self.timeout + self.cycle, after + self.timeout, STALE)

    def expect_detection(self, sure: bool, deadline: float, codes: frozenset[str] = IMPLAUSIBLE) -> Expectation:
        """Return the outcome of a fault with certain (`sure`) or possible detection."""
        return Expectation(codes | BALANCE, deadline + self.cycle if sure else None)


def expect(fault: Fault, settings: Settings) -> Expectation:
    """Return the expected outcome of a fault."""
    if getattr(fault, "stream", "") == "imu":  # the controller does not read it
        return HARMLESS
    rule = RULES[fault.kind()]
    if isinstance(rule, Expectation):
        return rule
    return rule(fault, RuleContext(settings, 2.0 / settings.control.rate, settings.safety.state_timeout))


def _spike(fault: Any, context: RuleContext) -> Expectation:
    """Single implausible samples are rejected, a sequence is a fault."""
    messages = np.ceil(np.log(_NEGLIGIBLE) / np.log(1.0 - fault.share**SEQUENCE))
    surely = float(messages) * 0.5 * SEQUENCE * context.cycle
    large = fault.size > context.exceeded("joint_mismatch")
    return context.expect_detection(large and surely < fault.duration, surely)


def _lost(fault: Any, context: RuleContext) -> Expectation:
    """A share of the messages is lost or refused."""
    return context.expect_stale(fault.duration) if fault.share == 1.0 else STALE_OR_BALANCE


def _growing_delay(fault: Any, context: RuleContext) -> Expectation:
    """Without synchronized clocks, a growing delay looks like a slow clock."""
    visible_growth = fault.growth if context.settings.safety.synchronized_clocks else fault.growth - 1.0
    too_old = context.timeout / visible_growth * (1.0 + fault.growth) if visible_growth > 0.0 else np.inf
    detected = too_old + context.timeout
    return context.expect_detection(detected + context.cycle < fault.duration, detected, STALE)


def _stamp_ahead(fault: Any, context: RuleContext) -> Expectation:
    limit = context.exceeded("clock_tolerance") if context.settings.safety.synchronized_clocks else _FAR_AHEAD
    return context.expect_stale(fault.duration) if fault.by > limit else STALE_OR_BALANCE


def _clock(fault: Any, context: RuleContext) -> Expectation:
    if fault.by < 0.0:
        return context.expect_detection(True, 0.0, CLOCK)
    return context.expect_detection(fault.by > _MARGIN * context.timeout, context.timeout, STALE | CLOCK)


def _refused_for(key: str) -> _Rule:
    """Messages are refused for the time in a parameter, at most for the duration."""
    return lambda fault, context: context.expect_stale(min(getattr(fault, key), fault.duration))


def _harmless_below(limits: Mapping[str, float], otherwise: Expectation = EITHER) -> _Rule:
    return lambda fault, context: (
        HARMLESS if all(abs(getattr(fault, key)) <= limit for key, limit in limits.items()) else otherwise
    )


def _jump(key: str, threshold: str, share: float = 1.0) -> _Rule:
    """A jump by a parameter, with a share along one axis, compared with a threshold of `safety`."""
    return lambda fault, context: context.expect_detection(
        share * getattr(fault, key) > context.exceeded(threshold), context.sequence
    )


def _drift(key: str, threshold: str, share: float = 1.0) -> _Rule:
    """The mismatch of a steady drift approaches drift · T."""

    def rule(fault: Any, context: RuleContext) -> Expectation:
        part = context.exceeded(threshold) / (share * getattr(fault, key) * MEMORY)
        time = -MEMORY * float(np.log(1.0 - part)) if part < 1.0 else np.inf
        if time < fault.duration:
            return context.expect_detection(True, time)
        return HARMLESS if getattr(fault, key) <= _SLOW_DRIFT else EITHER

    return rule


def _ramp(key: str, threshold: str, share: float = 1.0) -> _Rule:
    """The mismatch of a ramp decays with T."""

    def rule(fault: Any, context: RuleContext) -> Expectation:
        value, grown = abs(share * getattr(fault, key)), min(fault.ramp, fault.duration)
        peak = value if fault.ramp == 0.0 else value / fault.ramp * MEMORY * (1.0 - np.exp(-grown / MEMORY))
        return context.expect_detection(peak > context.exceeded(threshold), grown + context.sequence)

    return rule


def _frozen(fault: Any, context: RuleContext) -> Expectation:
    safety = context.settings.safety
    lasts = max(safety.frozen_time, safety.state_timeout) + context.cycle
    return context.expect_detection(fault.duration > lasts, lasts)


_FAR_AHEAD = 0.26  # advance of a refused stamp, s (middleware/stamps.py)
_SLOW_DRIFT = 0.01  # m/s or rad/s
_ALONG = float(np.sqrt(0.5))  # smallest share of a horizontal direction along an axis
_EITHER = (
    "joint_scale", "joint_lag", "joint_frozen", "joints_swapped", "velocity_sign", "velocity_dead", "command_delay",
    "actuator_dead", "actuator_reversed", "actuator_gain", "actuator_weak", "actuator_delay", "joint_friction",
    "joint_locked", "payload", "slippery_floor", "soft_floor", "floor_drop", "floor_hole", "far_setpoint",
    "step_setpoint", "contact_off", "conflicting_updates",
)  # fmt: skip
_HARMLESS = (
    "imu_noise", "imu_bias", "imu_shock", "message_duplication", "command_twice", "garbage", "unknown_words",
    "request_flood", "long_trajectory", "huge_message",
)  # fmt: skip
_MISSING = (
    "joint_missing", "odom_bad_quaternion", "odom_wrong_frame", "message_dropout", "message_queue", "stamp_zero",
    "stamp_frozen",
)  # fmt: skip
#: Expected outcome of each kind of fault, or its rule.
RULES: Mapping[str, Expectation | _Rule] = {
    **dict.fromkeys(_EITHER, EITHER),
    **dict.fromkeys(_HARMLESS, HARMLESS),
    **dict.fromkeys(_MISSING, _refused_for("duration")),
    **dict.fromkeys(
        ("joint_absurd", "odom_absurd"), lambda fault, context: context.expect_detection(True, context.sequence)
    ),
    **dict.fromkeys(
        ("estop", "estop_in_flood"), lambda fault, context: Expectation(frozenset({"ESTOP"}), context.cycle)
    ),
    "joint_noise": _harmless_below({"sigma": 1e-4, "velocity_sigma": 1e-3}),
    "joint_bias": _ramp("bias", "joint_mismatch"),
    "joint_quantization": _harmless_below({"step": 2e-4}),
    "joint_spike": _spike,
    "joint_jump": _jump("size", "joint_mismatch"),
    "joint_states_frozen": _frozen,
    "joint_not_a_number": _lost,
    "velocity_lag": _harmless_below({"time_constant": 0.002}),
    "odom_noise": _harmless_below({"sigma": 1e-4, "turn_sigma": 1e-4}),
    "odom_velocity_noise": _harmless_below({"sigma": 1e-3}),
    "odom_drift": _drift("speed", "base_mismatch", _ALONG),
    "odom_turn_drift": _drift("rate", "base_turn_mismatch"),
    "odom_jump": _jump("size", "base_mismatch", _ALONG),
    "odom_turn_jump": _jump("angle", "base_turn_mismatch"),
    "odom_tilt": _ramp("angle", "base_turn_mismatch", _ALONG),
    "odom_frozen": _frozen,
    "odom_lag": _harmless_below({"time_constant": 0.002}),
    "odom_slow": _refused_for("period"),
    "odom_not_a_number": _lost,
    "message_delay": _refused_for("delay"),
    "message_growing_delay": _growing_delay,
    "message_jitter": STALE_OR_BALANCE,
    "message_loss": lambda fault, context: HARMLESS if fault.share <= 0.1 else _lost(fault, context),
    "message_reordering": STALE_OR_BALANCE,
    "message_replay": lambda fault, context: context.expect_stale(fault.duration - fault.length, fault.length),
    "command_loss": _harmless_below({"share": 0.02}),
    "stamp_back": _refused_for("by"),
    "stamp_ahead": _stamp_ahead,
    "stamp_drift": _harmless_below({"rate": 1e-3}, STALE_OR_BALANCE),
    "clock_jump": _clock,
    "clock_frozen": lambda fault, context: context.expect_detection(
        fault.duration > context.timeout + context.cycle, context.timeout, STALE | CLOCK
    ),
    "clock_drift": Expectation(STALE | CLOCK | BALANCE),
    "actuator_bias": _harmless_below({"share": 0.005}),
    "actuator_noise": _harmless_below({"share": 0.002}),
    "actuator_lag": _harmless_below({"time_constant": 0.001}),
    "mass_error": _harmless_below({"share": 0.02}),
    "center_of_mass_error": _harmless_below({"offset": 0.005}),
    "floor_tilt": _harmless_below({"angle": 0.01}),
    "push": _harmless_below({"share": 0.01}),
    "kick": _harmless_below({"speed": 0.03}),
}
