"""Decisions of the guard: silence, timely damping, bounded torques."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wbc_controller.records import Mode
from wbc_controller.safety.guard import ZERO_TIME, Guard, GuardInputs, GuardMode
from wbc_controller.settings.config import load

EFFORT = np.array([100.0, 20.0, 5.0])
PERIOD = 0.002
PATIENCE = 0.01
CONFIG = load("go2").replace({
    "guard.patience": PATIENCE, "guard.damping_time": 0.5, "guard.torque": 0.2, "limits.torque_rate": 0.2 / PERIOD,
    "safety.state_timeout": 0.05, "control.rate": 1.0 / PERIOD, "control.trigger": "joint_states",
})  # fmt: skip
BY_TIMER = CONFIG.replace({"control.trigger": "timer"})
HOLDING = np.array([60.0, -10.0, 2.0])
SPEED = np.array([1.0, -0.5, 0.2])


class Rig:
    """Guard with inputs in simulated time; records its torques."""

    def __init__(self, config=CONFIG):
        self.guard = Guard(config.settings, EFFORT, 2.0 * np.eye(3))
        self.now = 10.0
        self.inputs = GuardInputs(-math.inf, np.zeros(3), math.inf, None, None, -math.inf)
        self.sent = []

    def hear(self, **changes):
        self.inputs = dataclasses.replace(self.inputs, **changes)

    def command(self, torques=HOLDING, mode=Mode.ACTIVE):
        self.hear(command_at=self.now, torques=np.asarray(torques, dtype=float), unanswered_at=math.inf, mode=mode)

    def state(self, velocity=SPEED):
        velocity = None if velocity is None else np.asarray(velocity, dtype=float)
        self.hear(velocity=velocity, velocity_at=self.now, unanswered_at=min(self.inputs.unanswered_at, self.now))

    def step(self):
        self.sent.append(self.guard.step(self.now, self.inputs))
        return self.sent[-1]

    def run(self, duration, *, states=True, commands=False, velocity=SPEED, torques=HOLDING, mode=Mode.ACTIVE):
        """Advance in periods: state, command, decision."""
        for _ in range(round(duration / PERIOD)):
            self.now += PERIOD
            if states:
                self.state(velocity)
            if commands:
                self.command(torques, mode)
            self.step()
        return self.sent[-round(duration / PERIOD) :]


@pytest.fixture
def rig():
    """Return a rig in which commands have come for 0.1 s."""
    rig = Rig()
    rig.run(0.1, commands=True)
    return rig


def test_it_is_silent_while_commands_flow_and_before_the_first_one():
    rig = Rig()
    assert set(rig.run(1.0, commands=True)) == {None}
    assert rig.guard.mode is GuardMode.WATCHING
    rig = Rig()
    rig.hear(mode=Mode.ACTIVE)  # latched mode of a dead controller
    assert set(rig.run(1.0)) == {None}
    assert rig.guard.mode is GuardMode.IDLE


@pytest.mark.parametrize("config", [CONFIG, BY_TIMER])
def test_it_damps_in_time_then_sends_zero_then_nothing(config):
    rig = Rig(config)
    rig.run(0.1, commands=True)
    sent = rig.run(0.5 + ZERO_TIME + 0.1)
    first = next(i for i, tau in enumerate(sent) if tau is not None)
    late = (first + 1) * PERIOD  # since the last command: the first missed one would have come a period after it
    assert PATIENCE <= late - PERIOD <= PATIENCE + 2 * PERIOD
    damping = -2.0 * SPEED
    reached = next(i for i in range(first, len(sent)) if np.allclose(sent[i], damping))
    assert reached - first <= 3
    assert all(np.array_equal(tau, damping) for tau in sent[reached : first + 249])
    zeros = [tau for tau in sent[first + 252 :] if tau is not None]
    assert not np.any(zeros)
    assert len(zeros) == pytest.approx(ZERO_TIME / PERIOD, abs=5)
    assert sent[-1] is None
    assert rig.guard.mode is GuardMode.RELEASED
    assert rig.guard.reason == "COMMANDS_STOPPED: the last command came 12 ms ago, in mode active"
    assert rig.guard.takeovers == 1


def test_a_triggered_controller_owes_nothing_without_joint_states_until_these_are_stale(rig):
    assert set(rig.run(0.05 + PATIENCE, states=False)) == {None}
    assert rig.run(0.01, states=False)[-1] is not None


@pytest.mark.parametrize("mode", [Mode.INACTIVE, Mode.STOPPED, Mode.FAULT])
def test_a_controller_that_has_let_go_is_left_alone(rig, mode):
    rig.now += PERIOD
    rig.command(np.zeros(3), mode)
    assert set(rig.run(1.0)) == {None}
    assert rig.guard.mode is GuardMode.IDLE


@pytest.mark.parametrize(
    ("mode", "torques"),
    [(mode, HOLDING) for mode in (Mode.INACTIVE, Mode.STOPPED, Mode.FAULT)]
    + [(mode, np.zeros(3)) for mode in (Mode.ACTIVE, Mode.HOLDING, Mode.DAMPING, None)],
)
def test_death_during_a_ramp_to_zero_is_a_takeover(mode, torques):
    rig = Rig()
    rig.run(0.1, commands=True, torques=torques, mode=mode)
    assert rig.run(0.1)[-1] is not None


@pytest.mark.parametrize("after", [0.05, 1.0, 2.0])  # while damping, at zero, released
def test_a_command_ends_it_at_once_and_the_next_silence_begins_anew(rig, after):
    rig.run(after)
    rig.now += 1e-6
    rig.command()
    assert rig.step() is None
    assert rig.guard.mode is GuardMode.WATCHING
    assert rig.guard.reason == ""
    assert set(rig.run(0.5, commands=True)) == {None}
    assert rig.run(0.1)[-1] is not None
    assert rig.guard.takeovers == 2


def test_a_restarted_controller_that_waits_does_not_end_the_damping(rig):
    rig.run(0.1)
    rig.hear(mode=Mode.INACTIVE)
    assert np.allclose(rig.run(0.1)[-1], -2.0 * SPEED)


@pytest.mark.parametrize("velocity", [None, [np.nan, 0.0, 0.0], [0.0, np.inf, 0.0]], ids=["none", "nan", "infinite"])
def test_without_usable_velocities_the_torques_sink_to_zero(rig, velocity):
    sent = [tau for tau in rig.run(0.1, velocity=velocity) if tau is not None]
    assert np.isfinite(sent).all()
    assert not sent[-1].any()
    assert rig.guard.velocity_is_stale(rig.now, rig.inputs)


def test_with_stale_velocities_the_torques_sink_to_zero_and_rise_when_they_come_back(rig):
    rig.run(0.1)
    assert not rig.run(0.1, states=False)[-1].any()
    assert rig.guard.velocity_is_stale(rig.now, rig.inputs)
    assert np.allclose(rig.run(0.02)[-1], -2.0 * SPEED)
    assert not rig.guard.velocity_is_stale(rig.now, rig.inputs)


@pytest.mark.parametrize("often", [1, 5])
def test_the_torque_rate_is_per_second_however_often_it_is_asked(often):
    rig = Rig(CONFIG.replace({"limits.torque_rate": 1.0}))
    towards = np.sign(-HOLDING) * EFFORT
    rig.run(0.1, commands=True)
    rig.now += PATIENCE
    rig.state(np.zeros(3))
    rig.now += PATIENCE
    last = rig.step()
    np.testing.assert_allclose(last, HOLDING + towards * PERIOD)  # from the last command
    for _ in range(3 * often):
        rig.now += PERIOD / often
        tau = rig.step()
        np.testing.assert_allclose(tau, last + towards * PERIOD / often)
        last = tau
    rig.now += 10.0 * PERIOD  # late: at most one period
    np.testing.assert_allclose(rig.step(), last + towards * PERIOD)
    last = rig.sent[-1]
    rig.now -= 1e-3  # the clock went back: no change
    np.testing.assert_array_equal(rig.step(), last)


numbers = st.floats(-1e6, 1e6) | st.sampled_from([np.nan, np.inf, -np.inf])
vectors = st.lists(numbers, min_size=3, max_size=3)
kinds = st.sampled_from(["command", "state", "mode", "pass"])
events = st.lists(st.tuples(kinds, st.floats(0.0, 0.1), vectors, st.sampled_from([None, *Mode])), max_size=80)


@settings(max_examples=120)
@given(events, st.sampled_from([CONFIG, BY_TIMER]))
def test_whatever_happens(history, config):
    """Torques are finite, bounded and without jumps, and end at zero."""
    rig = Rig(config)
    before = None
    for what, pause, values, mode in history:
        rig.now += pause
        if what == "command":
            rig.command(values, mode)
        elif what == "state":
            rig.state(values)
        elif what == "mode":
            rig.hear(mode=mode)
        tau = rig.step()
        if tau is not None:
            assert rig.now - rig.inputs.command_at >= PATIENCE
            assert np.isfinite(tau).all()
            assert (np.abs(tau) <= EFFORT).all()
            if before is not None:
                assert (np.abs(tau - before) <= 0.2 * EFFORT + 1e-9).all()
        before = tau
    assert rig.run(0.5 + ZERO_TIME + 0.2, states=False)[-1] is None
    sent = [tau for tau in rig.sent if tau is not None]
    if sent and rig.guard.mode is GuardMode.RELEASED:
        assert not sent[-1].any()


@settings(max_examples=100)
@given(st.lists(st.floats(-20.0, 20.0), min_size=3, max_size=3))
def test_damping_takes_energy_and_leaves_little_for_whoever_takes_over(velocity):
    rig = Rig()
    rig.run(0.02, commands=True)
    tau = rig.run(0.1, velocity=velocity)[-1]
    assert (tau * np.array(velocity) <= 0.0).all()
    assert (np.abs(tau) <= 0.2 * EFFORT + 1e-12).all()
    assert (np.abs(tau) >= np.minimum(2.0 * np.abs(velocity), 0.2 * EFFORT) - 1e-12).all()
