"""Expected outcomes of faults, from their parameters and the settings."""

import numpy as np
import pytest

from wbc_controller.settings.config import load
from wbc_controller.simulation.faults.catalogue import draw
from wbc_controller.validation.campaign.expectations import BALANCE, RULES, expect
from wbc_controller.validation.campaign.trial import ALL_KINDS

SETTINGS = load("go2").settings
SYNCHRONIZED = load("go2").replace({"safety.synchronized_clocks": True}).settings
CYCLE = 0.004  # two periods


def made(kind, **parameters):
    return ALL_KINDS[kind].model_validate(parameters)


def label(expected):
    return "survive" if not expected.codes else "either" if expected.deadline is None else "detect"


@pytest.mark.parametrize("kind", RULES)
def test_rules_accept_all_random_parameters(kind):
    assert set(RULES) == set(ALL_KINDS)
    for seed in range(20):
        rng = np.random.default_rng(seed)
        for settings in (SETTINGS, SYNCHRONIZED):
            expected = expect(draw(ALL_KINDS[kind], rng, duration=rng.uniform(0.05, 0.6)), settings)
            assert expected.deadline is None or (expected.codes and 0.0 < expected.deadline < 10.0)
            assert "INTERNAL_ERROR" not in expected.codes


@pytest.mark.parametrize(
    ("kind", "parameters", "outcome", "deadline"),
    [
        ("message_dropout", {"duration": 0.04}, "either", None),
        ("message_dropout", {"duration": 0.1}, "detect", 0.05 + CYCLE),
        ("message_dropout", {"duration": 0.1, "stream": "imu"}, "survive", None),
        ("message_loss", {"share": 1.0, "duration": 0.1}, "detect", 0.05 + CYCLE),
        ("message_loss", {"share": 0.05}, "survive", None),
        ("joint_not_a_number", {"duration": 0.1}, "detect", 0.05 + CYCLE),
        ("joint_not_a_number", {"duration": 0.1, "share": 0.5}, "either", None),
        ("joint_states_frozen", {"duration": 0.2}, "detect", 0.1 + 2 * CYCLE),
        ("odom_jump", {"size": 0.3}, "detect", 2 * CYCLE),
        ("odom_jump", {"size": 0.12}, "either", None),  # possibly below the limit along each axis
        ("odom_drift", {"speed": 1.0, "duration": 0.5}, "detect", -0.2 * np.log(1 - 0.11 / (0.2 * 0.5**0.5)) + CYCLE),
        ("odom_drift", {"speed": 0.005}, "survive", None),
        ("joint_bias", {"bias": 0.5, "ramp": 0.0}, "detect", 2 * CYCLE),
        ("joint_bias", {"bias": 0.5, "ramp": 1.0}, "either", None),  # forgotten during its growth
        ("joint_noise", {"sigma": 1e-4, "velocity_sigma": 1e-3}, "survive", None),
        ("joint_noise", {"sigma": 1e-2}, "either", None),
        ("message_replay", {"length": 0.1, "duration": 0.5}, "detect", 0.15 + CYCLE),
        ("stamp_ahead", {"by": 1.0, "duration": 0.5}, "detect", 0.05 + CYCLE),
        ("clock_jump", {"by": -0.1}, "detect", CYCLE),
        ("clock_jump", {"by": 0.02}, "either", None),
        ("clock_frozen", {"duration": 0.2}, "detect", 0.05 + CYCLE),
        ("clock_frozen", {"duration": 0.05}, "either", None),
        ("estop", {}, "detect", CYCLE),
    ],
)
def test_expectations(kind, parameters, outcome, deadline):
    expected = expect(made(kind, **parameters), SETTINGS)
    assert (label(expected), expected.deadline) == (outcome, deadline if deadline is None else pytest.approx(deadline))


def test_expectations_follow_from_the_settings():
    slow = load("go2").replace({"safety.state_timeout": 0.2, "control.rate": 250.0}).settings
    assert expect(made("message_dropout", duration=0.5), slow).deadline == pytest.approx(0.208)
    for fault in (made("message_growing_delay", growth=0.5, duration=1.0), made("stamp_ahead", by=0.1, duration=0.5)):
        assert label(expect(fault, SETTINGS)) == "either"
        assert label(expect(fault, SYNCHRONIZED)) == "detect"
    for kind in ("actuator_dead", "floor_drop", "kick", "payload"):
        assert expect(made(kind), SETTINGS).codes == BALANCE
