"""Joint velocities from positions and stamps."""

import math

import numpy as np
import pytest

from wbc_controller.controller.build.safety import make_supervisor_limits
from wbc_controller.estimation.joint_velocity import VelocityFilter, delay

T = 0.004
IRREGULAR = 1.0 + np.cumsum(np.random.default_rng(0).uniform(0.0005, 0.006, 92))  # s


def fed(stamps, position):
    """Return the filter's velocities of a motion at times in s."""
    found = VelocityFilter(T)
    return np.array([found.update(round(1e9 * time), np.array([position(time)]))[0] for time in stamps])


@pytest.mark.parametrize("stamps", [1.0 + 0.002 * np.arange(100), IRREGULAR], ids=["regular", "irregular"])
def test_a_steady_velocity_is_told_exactly(stamps):
    assert fed(stamps, lambda time: 3.0 - 0.7 * time)[-1] == pytest.approx(-0.7, abs=1e-6)


@pytest.mark.parametrize("period", [0.0005, 0.002, 0.01, 0.1])
def test_delay_of_a_ramp(period):
    stamps = 1.0 + period * np.arange(400)
    velocity = fed(stamps, lambda time: 0.5 * 2.0 * (time - 1.0) ** 2)
    assert (stamps[-1] - 1.0) - velocity[-1] / 2.0 == pytest.approx(delay(T, period), rel=1e-4)


def test_delay_noise_and_gaps():
    assert delay(T, 1e-7) == pytest.approx(2.0 * T, rel=1e-3)
    assert delay(T, 1.0) == pytest.approx(0.5)
    noise = 5e-5 * np.random.default_rng(1).standard_normal(4000)
    found = VelocityFilter(T)
    velocity = [found.update(2_000_000 * (i + 1), np.array([each]))[0] for i, each in enumerate(noise)]
    assert np.std(velocity[100:]) < 0.15 * np.std(np.diff(noise) / 0.002)
    found = VelocityFilter(T)
    found.update(1_000_000, np.array([0.0]))
    assert found.update(1_001_000_000, np.array([0.5]))[0] == pytest.approx(0.5, rel=1e-6)


def test_start_repetition_and_restart():
    found = VelocityFilter(T)
    assert math.isinf(found.delay)
    np.testing.assert_array_equal(found.update(5_000_000, np.array([1.0, 2.0])), [0.0, 0.0])
    moving = found.update(7_000_000, np.array([1.1, 2.0]))
    assert moving[0] > 1.0
    assert moving[1] == 0.0
    assert found.delay == pytest.approx(delay(T, 0.002))
    np.testing.assert_array_equal(found.update(7_000_000, np.array([9.0, 9.0])), moving)
    np.testing.assert_array_equal(found.update(3_000_000, np.array([1.2, 2.0])), [0.0, 0.0])


def test_damping_is_made_for_velocities_that_are_late(robot_of, changed):
    settings, model = robot_of("go2")
    without = changed(settings, {"estimation": {"joint_velocity": "differentiated", "joint_velocity_time": T}})
    assert make_supervisor_limits(settings, model).velocity_delay == 0.0
    assert make_supervisor_limits(without, model).velocity_delay == pytest.approx(delay(T, 0.002))
