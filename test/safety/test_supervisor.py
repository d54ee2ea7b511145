"""Supervisor: requests, ramps, holding, damping, and bounds of commands."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import input_refusal
from unchecked import UNCHECKED

from wbc_controller.errors import InputRefused, NoSolution
from wbc_controller.inverse_dynamics.limits import TorqueSpeedCurve
from wbc_controller.records import REQUESTS, Fault, Mode, RobotState, Solution
from wbc_controller.safety.supervisor import Supervisor, SupervisorLimits
from wbc_controller.settings.service import SafetySettings

STALE = Fault("STALE_INPUT", "odom is 60 ms old (limit 50 ms)")
NOTHING = NoSolution("the contacts (left, right) conflict", "infeasible", None)
PERIOD = 0.002


def solution(model, tau):
    return Solution(v_dot=np.zeros(model.nv), tau=np.asarray(tau, dtype=float), iterations=1)


class Rig:
    """Supervisor in simulated time with all its commands."""

    def __init__(self, model, **changes):
        self.model = model
        values = dict(activation_ramp=0.1, hold_time=0.02, hold_window=0.0, damping_time=0.05, relax_time=math.inf)
        safety = {**UNCHECKED, **values, **{key: changes.pop(key) for key in [*changes] if key in values}}
        safety = SafetySettings().model_copy(update=safety)  # without validation
        limits = SupervisorLimits(safety=safety, **{"torque_rate": 100.0, "period": PERIOD, **changes})
        self.supervisor = Supervisor(model, limits)
        self.now = 10.0
        self.state = RobotState(7, model.configuration(model.posture), np.zeros(model.nv))
        self.tau = 0.5 * model.effort_limits
        self.commands = []

    @property
    def mode(self):
        return self.supervisor.mode

    def request(self, word, problem=None):
        return self.supervisor.request(word, self.now, problem)

    def step(self, outcome="solution", count=1, problem=None, velocity=0.0, dt=PERIOD):
        """Step with the joint velocity, or None if stale."""
        for _ in range(count):
            self.now += dt
            speeds = None if velocity is None else np.full(self.model.na, velocity)
            made = solution(self.model, self.tau) if isinstance(outcome, str) else outcome
            given_outcome = made if self.supervisor.solving and problem is None else None
            self.commands.append(self.supervisor.step(self.now, self.state, speeds, problem, given_outcome))
        return self.commands[-1]

    def bring(self, where):
        """Enter a mode; `damping!`, `fault!` with a fault, others by request."""
        if where == "inactive":
            return self
        self.request("activate")
        self.step(count=100)
        if where == "holding":
            self.step(NOTHING)
        elif where in ("damping", "stopped"):
            self.request("damp")
            self.step(count=30 if where == "stopped" else 0)
        elif where in ("damping!", "fault!"):
            self.step(problem=STALE, count=30 if where == "fault!" else 1)
        assert self.mode.value == where.rstrip("!")
        return self


@pytest.fixture(scope="module")
def model(robot_of):
    return robot_of("go2")[1]


@pytest.fixture
def rig(model):
    return lambda **changes: Rig(model, **changes)


RESET_FIRST = "send 'reset' first"
TYPO = "'actvate' is unknown; did you mean 'activate'? Valid: activate, damp"
WORDS = (*REQUESTS, "actvate")
TABLE = {
    # mode: results of activate, deactivate, damp, reset and estop: a mode, or part of the refusal
    "inactive": (Mode.ACTIVE, "the controller is inactive", "the controller is inactive", Mode.INACTIVE, Mode.FAULT),
    "active": ("active already", Mode.ACTIVE, Mode.DAMPING, "'deactivate' or 'damp' first", Mode.FAULT),
    "holding": ("holding already", Mode.HOLDING, Mode.DAMPING, "'deactivate' or 'damp' first", Mode.FAULT),
    "damping": (f"in damping; {RESET_FIRST}", "is damping; use 'reset'", "is damping", Mode.INACTIVE, Mode.FAULT),
    "damping!": (f"(STALE_INPUT); {RESET_FIRST}", "is damping", "is damping", Mode.INACTIVE, Mode.FAULT),
    "stopped": (f"in stopped; {RESET_FIRST}", "is stopped; use 'reset'", "is stopped", Mode.INACTIVE, Mode.FAULT),
    "fault!": (f"(STALE_INPUT); {RESET_FIRST}", "is fault; use 'reset'", "is fault", Mode.INACTIVE, Mode.FAULT),
}


@pytest.mark.parametrize(
    ("where", "word", "result"),
    [(where, word, result) for where, row in TABLE.items() for word, result in zip(WORDS, (*row, TYPO), strict=True)],
)
def test_every_request_in_every_mode(rig, where, word, result):
    bench = rig().bring(where)
    before, fault = bench.mode, bench.supervisor.fault
    if isinstance(result, Mode):
        assert bench.request(word) is (word == "activate")
        assert bench.mode is result
        assert (bench.supervisor.fault is None) == (result is not Mode.FAULT and where != "holding")
        return
    refusal = input_refusal(bench.request, word)
    assert result in refusal
    assert repr(word) in refusal
    assert (bench.mode, bench.supervisor.fault) == (before, fault)


@pytest.mark.parametrize("where", TABLE)
def test_in_every_mode_the_end_leaves_no_torque(rig, where):
    bench = rig().bring(where)
    command = bench.supervisor.shut_down(bench.now)
    if where == "inactive":
        assert command is None
    else:
        assert not command.tau.any()
        assert bench.mode is Mode.STOPPED


@pytest.mark.parametrize("where", TABLE)
def test_an_emergency_stop_takes_the_torque_away_at_once_and_is_latched(rig, where):
    bench = rig().bring(where)
    bench.request("estop")
    for _ in range(3):
        assert not bench.step(velocity=1.0).tau.any()
    assert bench.mode is Mode.FAULT
    assert bench.supervisor.fault.code == "ESTOP"
    assert "(ESTOP)" in input_refusal(bench.request, "activate")
    bench.request("reset")
    assert bench.request("activate")


def shares(bench):
    return np.array([command.tau / bench.tau for command in bench.commands if command is not None])


def test_torques_ramp_in_from_zero_in_the_activation_ramp(rig):
    bench = rig(torque_rate=1e5)
    bench.request("activate")
    bench.step(dt=0.0)
    bench.step(count=60)
    share = shares(bench)
    assert not share[0].any()
    assert (np.diff(share, axis=0) >= 0.0).all()
    np.testing.assert_allclose(share[:51], np.outer(np.arange(51) / 50.0, np.ones(bench.model.na)), atol=1e-9)
    assert (share[51:] == 1.0).all()


def test_a_deactivation_ramps_the_torques_out_once(rig):
    bench = rig(torque_rate=1e5).bring("active")
    bench.commands.clear()
    bench.request("deactivate")
    bench.step(count=55)
    share = shares(bench)
    assert bench.mode is Mode.INACTIVE
    assert bench.commands[-1] is None
    assert (np.diff(share, axis=0) <= 0.0).all()
    assert share[0, 0] == pytest.approx(0.98)
    assert not share[-1].any()
    bench = rig(torque_rate=1e5).bring("active")
    bench.commands.clear()
    for _ in range(55):
        if bench.mode is Mode.ACTIVE:
            bench.request("deactivate")
        bench.step()
    assert bench.mode is Mode.INACTIVE
    assert (np.diff(shares(bench), axis=0) <= 0.0).all()
    bench = rig(torque_rate=1e5)
    bench.request("activate")
    bench.step(count=15)
    bench.request("deactivate")
    bench.step(count=60)
    share = shares(bench)[:, 0]
    assert share.max() == pytest.approx(0.3)
    assert np.abs(np.diff(share)).max() <= 0.021
    assert bench.mode is Mode.INACTIVE


def test_holding_neither_cuts_a_ramp_short_nor_forgets_a_deactivation(rig):
    bench = rig(torque_rate=1e5)
    bench.request("activate")
    bench.step(count=10)
    bench.step(NOTHING, count=2)
    assert bench.mode is Mode.HOLDING
    bench.step(count=40)
    assert (bench.mode, bench.supervisor.fault) == (Mode.ACTIVE, None)
    assert shares(bench)[12, 0] == pytest.approx(13 / 50)
    assert np.abs(np.diff(shares(bench)[:, 0])).max() <= 0.061  # three periods' worth, after two of holding
    bench = rig().bring("active")
    bench.request("deactivate")
    bench.step(count=5)
    bench.step(NOTHING, count=2)
    bench.step(count=60)
    assert bench.mode is Mode.INACTIVE


def test_the_torque_rate_is_held_in_the_problem_only_after_the_ramp(rig):
    bench = rig()
    assert bench.supervisor.torques_before(bench.now) is None
    bench.request("activate")
    bench.step(count=49)
    assert bench.supervisor.torques_before(bench.now) is None
    bench.step(count=2)
    np.testing.assert_array_equal(bench.supervisor.torques_before(bench.now), bench.commands[-1].tau)
    bench.request("deactivate")
    bench.step()
    assert bench.supervisor.torques_before(bench.now) is None
    bench = rig(torque_rate=2.0)
    wanted, bench.tau = bench.tau, 0.0 * bench.tau
    bench.request("activate")
    bench.step(count=10)  # reaches the solution
    bench.tau = wanted
    bench.step(count=50)
    assert (bench.commands[-1].tau < 0.9 * wanted).all()
    assert bench.supervisor.torques_before(bench.now) is None


def test_filtered_torques_follow_the_solutions_and_delay_no_stop(rig):
    bench = rig(torque_filter=0.006, torque_rate=1e5).bring("active")
    np.testing.assert_allclose(bench.commands[-1].tau, bench.tau, rtol=1e-6)  # unfiltered on the ramp
    before, bench.tau = bench.tau, -0.4 * bench.model.effort_limits
    for count in range(1, 8):
        sent = bench.step().tau
        np.testing.assert_allclose(sent, bench.tau + np.exp(-count * PERIOD / 0.006) * (before - bench.tau), rtol=1e-6)
        np.testing.assert_array_equal(bench.supervisor.torques_before(bench.now), sent)
    late = bench.step(dt=0.006).tau  # late states: elapsed time counts
    np.testing.assert_allclose(late, bench.tau + np.exp(-1.0) * (sent - bench.tau), rtol=1e-6)
    for word in ("estop", "damp"):
        bench = rig(torque_filter=0.05, torque_rate=1e5).bring("active")
        bench.request(word)
        assert not bench.step().tau.any()


def test_filtered_torques_change_at_a_share_of_the_rate_also_after_relaxed_solutions(rig):
    bench = rig(torque_filter=0.001, torque_rate=10.0).bring("active")
    before = bench.commands[-1].tau
    bench.tau = -bench.tau
    sent = bench.step(replace(solution(bench.model, bench.tau), relaxed=("torque_rate",))).tau
    np.testing.assert_allclose(before - sent, 0.33 * 10.0 * PERIOD * bench.model.effort_limits, rtol=1e-9)
    assert bench.mode is Mode.ACTIVE


def test_a_command_carries_the_stamp_it_answers_and_where_its_torques_lead(rig):
    bench = rig().bring("active")
    v_dot = np.arange(bench.model.nv, dtype=float)
    command = bench.step(replace(solution(bench.model, bench.tau), v_dot=v_dot))
    joints = v_dot[bench.model.v_index]
    assert command.stamp == 7
    np.testing.assert_allclose(command.v_desired, PERIOD * joints)
    np.testing.assert_allclose(command.q_desired, bench.model.posture + PERIOD**2 * joints)
    held = bench.step(NOTHING)
    assert np.isnan(held.q_desired).all()
    assert np.isnan(held.v_desired).all()


def test_the_ladder_from_no_solution_to_fault(rig):
    bench = rig(torque_rate=1e5).bring("active")
    held = bench.commands[-1].tau
    command = bench.step(NOTHING, velocity=1.0)
    assert bench.mode is Mode.HOLDING
    assert (bench.supervisor.fault.code, bench.supervisor.fault.sentence) == ("NO_SOLUTION", str(NOTHING))
    np.testing.assert_allclose(command.tau, held - 2.0)
    bench.step(NOTHING, count=9, velocity=1.0)
    assert bench.mode is Mode.HOLDING
    np.testing.assert_allclose(bench.commands[-1].tau, held - 2.0)
    command = bench.step(NOTHING, count=2, velocity=1.0)
    assert bench.mode is Mode.DAMPING
    np.testing.assert_allclose(command.tau, -2.0)
    bench.step(count=23, velocity=1.0)
    assert bench.mode is Mode.DAMPING
    assert bench.commands[-1].tau.any()
    command = bench.step(count=3, velocity=1.0)
    assert bench.mode is Mode.FAULT
    assert not command.tau.any()
    assert bench.supervisor.fault.code == "NO_SOLUTION"
    bench.step(count=1000)
    assert bench.mode is Mode.FAULT
    bench.request("reset")
    assert bench.supervisor.fault is None
    assert bench.request("activate")
    bench.step(count=60)
    np.testing.assert_allclose(bench.commands[-1].tau, bench.tau)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_no_torque_is_held_that_drives_a_joint_into_its_stop_but_one_that_slows_its_return(rig, side):
    bench = rig(hold_time=0.1).bring("active")
    model, bench.tau = bench.model, side * bench.tau
    bench.step(count=20)
    q = np.array(bench.state.q)
    end = model.position_upper if side > 0.0 else model.position_lower
    q[model.q_index[0]] = end[0] - side * 0.2  # reached in 40 ms
    q[model.q_index[1]] = end[1] - side * 0.3  # reached in 60 ms
    bench.state = RobotState(8, q, bench.state.v)
    bench.step(NOTHING, count=8, velocity=side * 5.0)
    damping = -2.0 * 5.0 * side
    np.testing.assert_allclose(bench.commands[-1].tau[:2], [damping, bench.tau[1] + damping])
    bench.step(NOTHING, count=12, velocity=-side * 5.0)  # returning
    assert bench.mode is Mode.HOLDING
    np.testing.assert_allclose(bench.commands[-1].tau[0], bench.tau[0] - damping)
    q[model.q_index[0]] = end[0] + side * 0.2
    bench.state = RobotState(9, q, bench.state.v)
    bench.step(NOTHING, count=8, velocity=-side)
    np.testing.assert_allclose(bench.commands[-1].tau[0], bench.tau[0] + side * 2.0)


@pytest.mark.parametrize("velocity", [None, np.nan, np.inf])
def test_damping_without_velocities_sinks_to_zero_at_the_torque_rate(rig, velocity):
    bench = rig(torque_rate=20.0).bring("active")
    start = bench.commands[-1].tau
    bench.commands.clear()
    bench.step(problem=STALE, count=20, velocity=velocity)
    step = 20.0 * PERIOD * bench.model.effort_limits
    for i, command in enumerate(bench.commands, start=1):
        np.testing.assert_allclose(command.tau, np.maximum(0.0, start - i * step), atol=1e-9)
    assert not bench.commands[-1].tau.any()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1.02, -1.02, 1e9])
def test_torques_that_are_not_usable_never_leave(rig, bad):
    bench = rig().bring("active")
    before = bench.commands[-1].tau
    tau = bench.tau.copy()
    tau[3] = bad * bench.model.effort_limits[3]
    command = bench.step(solution(bench.model, tau))
    assert bench.mode is Mode.HOLDING
    assert bench.supervisor.fault.code == "BAD_TORQUE"
    assert bench.model.joints[3] in bench.supervisor.fault.sentence
    np.testing.assert_array_equal(command.tau, before)
    bench.step(solution(bench.model, tau), count=12)
    assert bench.mode is Mode.DAMPING


def test_torques_a_solvers_tolerance_over_the_limit_are_cut_to_it(rig):
    bench = rig().bring("active")
    bench.tau = 1.005 * bench.model.effort_limits
    np.testing.assert_array_equal(bench.step(count=20).tau, bench.model.effort_limits)


#: Modes that may follow each mode.
EDGES = {
    "inactive": {"active"},
    "active": {"inactive", "holding", "damping"},
    "holding": {"active", "damping"},
    "damping": {"fault", "stopped", "inactive"},
    "stopped": {"inactive"},
    "fault": {"inactive"},
}

_torques = st.floats(-1.01, 1.01) | st.sampled_from([np.nan, np.inf, -np.inf, 1.0, -1.0, 1.011, 5.0, 1e300, -1e300])
_velocities = st.none() | st.floats(-50, 50) | st.sampled_from([np.nan, np.inf, -np.inf, 1e300])
_words = st.lists(st.sampled_from([*REQUESTS, "nonsense"]), max_size=2)
_kinds = st.sampled_from(["solution"] * 5 + ["none", "nothing", "fault", "stale"])
_times = st.sampled_from([0.0, PERIOD, PERIOD, PERIOD, 0.03, 0.2])
_cycles = st.lists(st.tuples(_words, _kinds, _torques, _velocities, _times), max_size=40)


@settings(max_examples=60)
@given(
    cycles=_cycles,
    ramp=st.sampled_from([0.0, 0.01, 0.1]),
    hold=st.sampled_from([0.0, 0.01]),
    damping=st.sampled_from([0.0, 0.05]),
    rate=st.sampled_from([1.0, 50.0, 1e5]),
    slow=st.sampled_from([0.0, 0.006]),
)
def test_commands_are_bounded_and_modes_follow_the_diagram(model, cycles, ramp, hold, damping, rate, slow):
    bench = Rig(model, activation_ramp=ramp, hold_time=hold, damping_time=damping, torque_rate=rate, torque_filter=slow)
    bench.request("activate")
    supervisor = bench.supervisor
    last = np.zeros(model.na)
    for words, kind, share, speed, dt in cycles:
        bench.now += dt
        problem = STALE if kind == "stale" else None
        for word in words:
            before = supervisor.mode.value
            try:
                supervisor.request(word, bench.now, problem)
            except InputRefused:
                assert supervisor.mode.value == before
            else:
                after = supervisor.mode.value
                assert word in REQUESTS
                assert after == before or after in EDGES[before] or (word, after) == ("estop", "fault")
                if word == "estop":
                    last = np.zeros(model.na)
        made = solution(model, share * model.effort_limits)
        outcome = {"solution": made, "nothing": NOTHING, "fault": Fault("INTERNAL_ERROR", "x")}.get(kind)
        before = supervisor.mode.value
        velocity = None if speed is None else np.full(model.na, speed)
        command = supervisor.step(bench.now, bench.state, velocity, problem, outcome if supervisor.solving else None)
        after = supervisor.mode.value
        assert after == before or after in EDGES[before] or (before, after) == ("holding", "inactive")
        assert (supervisor.fault is not None) or after not in ("holding", "fault")
        if command is None:
            assert after == "inactive"
            assert not last.any()
            continue
        assert np.isfinite(command.tau).all()
        assert (np.abs(command.tau) <= model.effort_limits).all()
        step = rate * PERIOD * model.effort_limits
        assert (np.abs(command.tau - last) <= step * (1.0 + 1e-9) + 1e-12).all()
        assert not command.tau.flags.writeable
        if after in ("inactive", "stopped", "fault"):
            assert (np.abs(command.tau) <= np.abs(last)).all()
        last = command.tau
    ended = supervisor.shut_down(bench.now)
    assert ended is None or not ended.tau.any()


def test_torques_of_the_motors_at_known_and_unknown_speeds(model):
    curve = TorqueSpeedCurve(np.full(model.na, 5.0), np.full(model.na, 15.0))
    rig = Rig(model, torque_speed=curve, torque_rate=5.0).bring("active")
    assert rig.commands[-1].tau == pytest.approx(rig.tau)
    rig.step(velocity=9.0)  # 60 % available, 50 % wanted
    assert rig.mode is Mode.ACTIVE
    rig.step(velocity=12.0)  # 30 %: refused; the torque drops at once
    assert rig.mode is Mode.HOLDING
    assert "hip" in rig.supervisor.fault.sentence
    assert (rig.commands[-1].tau <= 0.3 * rig.model.effort_limits + 1e-9).all()
    rig.step(velocity=-12.0)  # braking
    assert rig.mode is Mode.ACTIVE
    rig = Rig(model, torque_speed=curve).bring("active")
    for velocity in (None, np.nan, np.inf):
        rig.step(velocity=velocity)
        assert rig.mode is Mode.ACTIVE


def test_without_a_state_a_command_does_not_say_where_it_leads(rig):
    bench = rig().bring("active")
    bench.state = None
    command = bench.step()
    assert bench.mode is Mode.ACTIVE
    assert command.stamp == 0
    np.testing.assert_array_equal(command.tau, bench.tau)
    assert np.isnan([command.q_desired, command.v_desired]).all()
    assert not any(part.flags.writeable for part in (command.tau, command.q_desired, command.v_desired))


@pytest.mark.parametrize(("where", "word", "share"), [("inactive", "activate", 0.4), ("active", "deactivate", 0.6)])
def test_while_the_torques_ramp_in_or_out_nothing_is_filtered(rig, where, word, share):
    bench = rig(torque_filter=0.05, torque_rate=1e5).bring(where)
    bench.request(word)
    bench.step(count=20)
    np.testing.assert_allclose(bench.commands[-1].tau, share * bench.tau, rtol=1e-6)


def test_until_the_torques_have_reached_the_solution_s_they_change_at_the_rate_and_are_not_filtered(rig):
    bench = rig(activation_ramp=0.0, torque_filter=0.05, torque_rate=100.0)
    bench.request("activate")
    for share in (0.2, 0.4, 0.5):  # of the effort limits: 0.2 a period
        np.testing.assert_allclose(bench.step().tau, share * bench.model.effort_limits)
