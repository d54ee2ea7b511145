from dataclasses import replace

import numpy as np
import pytest

from wbc_controller.core.limits import JointMotionLimit, TorqueLimit
from wbc_controller.errors import NoSolution

PERIOD = 0.002


def fling(bench, joint, acceleration, state=None):
    """References that ask one arm joint for an acceleration, above all else, and the others to stay."""
    model = bench.model
    references = bench.references(state, posture=1000.0)
    posture = references.tasks["posture"]
    wanted = np.zeros(model.na)
    wanted[model.joints.index(joint)] = acceleration
    tasks = {**references.tasks, "posture": replace(posture, acceleration=wanted)}
    return replace(references, tasks=tasks)


ELBOW = "left_elbow_joint"
FREE = {"position": False, "velocity": False, "acceleration": 1.0e5}


@pytest.mark.parametrize("side", ["upper", "lower"])
def test_the_torque_limit_matters(bench, side):
    g1 = bench("g1", limits=FREE)
    i = g1.model.joints.index(ELBOW)
    sign = 1.0 if side == "upper" else -1.0
    references = fling(g1, ELBOW, sign * 2000.0)
    limit = g1.model.effort_limits[i]
    held = g1.controller.solve(g1.state(), references)
    assert sign * held.tau[i] == pytest.approx(limit, abs=1e-5)
    assert (np.abs(held.tau) <= g1.model.effort_limits + 1e-5).all()
    assert f"torque:{ELBOW}:{side}" in held.binding
    g1.controller.torque_limit = TorqueLimit(100.0 * g1.model.effort_limits, rate=100.0)
    free = g1.controller.solve(g1.state(), references)
    assert sign * free.tau[i] > limit + 1.0
    assert f"torque:{ELBOW}:{side}" not in free.binding


def test_the_torque_rate_matters(bench):
    g1 = bench("g1", limits={**FREE, "torque_rate": 10.0})
    i = g1.model.joints.index(ELBOW)
    before = g1.controller.solve(g1.state(), g1.references()).tau
    references = fling(g1, ELBOW, 100.0)
    step = 10.0 * g1.controller.period * g1.model.effort_limits
    free = g1.controller.solve(g1.state(), references)
    held = g1.controller.solve(g1.state(), references, before)
    assert (np.abs(free.tau - before) - step)[i] > 0.1
    assert (np.abs(held.tau - before) <= step + 1e-5).all()
    assert not held.relaxed
    assert f"torque:{ELBOW}:upper" in held.binding


def test_the_velocity_limit_matters(bench):
    limited = bench("g1", limits={"position": False, "velocity": True, "acceleration": 1.0e4})
    free = bench("g1", limits=FREE)
    i = limited.model.joints.index(ELBOW)
    column = limited.model.v_index[i]
    limit = limited.model.velocity_limits[i]
    v = np.zeros(limited.model.nv)
    v[column] = limit - 0.02
    state = limited.state(v=v)
    after = {}
    for name, robot in (("limited", limited), ("free", free)):
        solution = robot.controller.solve(state, fling(robot, ELBOW, 300.0 + 15.0 * limit))
        after[name] = v[column] + robot.controller.period * solution.v_dot[column]
        assert not solution.relaxed
        assert (f"motion:{ELBOW}:upper" in solution.binding) == (name == "limited")
    assert after["free"] > limit + 0.01
    assert after["limited"] <= limit + 1e-6


def test_the_position_limit_matters(bench):
    limited = bench("g1", limits={"position": True, "velocity": False})
    free = bench("g1", limits=FREE)
    model = limited.model
    i = model.joints.index(ELBOW)
    column = model.v_index[i]
    limit = model.position_upper[i] - limited.settings.limits.position_margin
    reached = {}
    for name, robot in (("limited", limited), ("free", free)):
        q, v = np.array(robot.stance), np.zeros(model.nv)
        q[model.q_index[i]] = limit - 0.3
        v[column] = 2.0
        farthest, bound = -np.inf, False
        for _ in range(150):  # the arm alone is moved: the rest stays in its stance
            state = robot.state(q, v)
            solution = robot.controller.solve(state, fling(robot, ELBOW, 60.0, state))
            acceleration = solution.v_dot[column]
            q[model.q_index[i]] += PERIOD * v[column] + 0.5 * PERIOD**2 * acceleration
            v[column] += PERIOD * acceleration
            farthest = max(farthest, q[model.q_index[i]])
            bound |= f"motion:{ELBOW}:upper" in solution.binding
            if name == "limited":
                assert not solution.relaxed
        reached[name] = farthest
        assert bound == (name == "limited")
    assert reached["free"] > limit + 0.1
    assert limit - 0.02 < reached["limited"] <= limit + 1e-6


@pytest.mark.parametrize("horizon", [0.001, 0.02, 0.1, 0.5])
@pytest.mark.parametrize("speed", [1.0, 5.0, 20.0])
@pytest.mark.parametrize("pushed", [False, True])
def test_a_joint_stops_at_its_position_limit_however_fast_it_comes(horizon, speed, pushed):
    """Simulate one joint that coasts, or pushes with all it may, towards each of its limits."""
    limit = JointMotionLimit(
        (np.array([-40.0]), np.array([40.0])), np.array([speed]), horizon=horizon, acceleration=1.0e5
    )
    for sign in (1.0, -1.0):
        q, v = np.array([sign * (40.0 - 1.5 * speed * max(horizon, 0.01))]), np.array([sign * speed])
        for _ in range(int(5.0 * max(horizon, 0.1) / PERIOD)):
            lower, upper = limit.bounds(q, v, PERIOD)
            assert (lower <= upper).all()
            most = upper if sign > 0.0 else lower
            acceleration = most if pushed else sign * np.minimum(sign * most, 0.0)
            q = q + PERIOD * v + 0.5 * PERIOD**2 * acceleration
            v = v + PERIOD * acceleration
            assert sign * q[0] <= 40.0 + 1e-9
            assert sign * v[0] <= speed + 1e-9
        if pushed:
            assert sign * q[0] == pytest.approx(40.0, abs=0.05 * speed * horizon + 1e-6)


def test_where_the_intervals_do_not_meet_position_goes_first():
    # Far above the upper position limit and going down faster than allowed: velocity asks up, position asks down.
    both = JointMotionLimit((np.array([-1.0]), np.array([1.0])), np.array([2.0]), horizon=0.1, acceleration=500.0)
    position = JointMotionLimit((np.array([-1.0]), np.array([1.0])), None, horizon=0.1, acceleration=500.0)
    velocity = JointMotionLimit(None, np.array([2.0]), horizon=0.1, acceleration=500.0)
    q, v = np.array([3.0]), np.array([-3.0])
    assert velocity.bounds(q, v, PERIOD)[0] > position.bounds(q, v, PERIOD)[1]  # they do not meet
    lower, upper = both.bounds(q, v, PERIOD)
    assert lower == upper == position.bounds(q, v, PERIOD)[1]


def test_where_the_intervals_meet_both_hold():
    rng = np.random.default_rng(0)
    position = JointMotionLimit((-np.ones(50), np.ones(50)), None, horizon=0.1, acceleration=500.0)
    velocity = JointMotionLimit(None, np.full(50, 2.0), horizon=0.1, acceleration=500.0)
    both = JointMotionLimit((-np.ones(50), np.ones(50)), np.full(50, 2.0), horizon=0.1, acceleration=500.0)
    q, v = rng.uniform(-0.9, 0.9, 50), rng.uniform(-2.5, 2.5, 50)
    bounds = [limit.bounds(q, v, 0.05) for limit in (position, velocity)]
    lower, upper = np.max([b[0] for b in bounds], axis=0), np.min([b[1] for b in bounds], axis=0)
    meet = lower <= upper
    assert meet.sum() > 10
    np.testing.assert_array_equal(both.bounds(q, v, 0.05)[0][meet], lower[meet])
    np.testing.assert_array_equal(both.bounds(q, v, 0.05)[1][meet], upper[meet])


def test_no_limit_asks_for_more_than_the_largest_acceleration():
    limit = JointMotionLimit((-np.ones(1), np.ones(1)), np.ones(1), horizon=0.01, acceleration=30.0)
    for q, v in ((5.0, 0.0), (-5.0, 0.0), (0.0, 50.0), (0.0, -50.0)):
        lower, upper = limit.bounds(np.array([q]), np.array([v]), PERIOD)
        assert -30.0 <= lower[0] <= upper[0] <= 30.0


def test_torque_bounds():
    limit = TorqueLimit(np.array([10.0, 20.0]), rate=5.0)
    np.testing.assert_array_equal(limit.bounds(None, 0.01), ([-10.0, -20.0], [10.0, 20.0]))
    lower, upper = limit.bounds(np.array([0.0, 19.5]), 0.01)
    np.testing.assert_allclose(lower, [-0.5, 18.5])
    np.testing.assert_allclose(upper, [0.5, 20.0])
    # A torque beyond its limit comes back at once: never an empty interval, never beyond the limit.
    lower, upper = limit.bounds(np.array([300.0, -300.0]), 0.01)
    np.testing.assert_allclose(lower, [9.5, -20.0])
    np.testing.assert_allclose(upper, [10.0, -19.0])


def test_nan_passes_through_the_bounds_to_where_it_is_refused():
    motion = JointMotionLimit((-np.ones(2), np.ones(2)), np.ones(2), horizon=0.1, acceleration=500.0)
    for q, v in (([np.nan, 0.0], [0.0, 0.0]), ([0.0, 0.0], [np.nan, 0.0])):
        lower, upper = motion.bounds(np.array(q), np.array(v), PERIOD)
        assert np.isnan([lower[0], upper[0]]).all()
        assert np.isfinite([lower[1], upper[1]]).all()
    lower, upper = TorqueLimit(np.ones(2), 1.0).bounds(np.array([np.nan, 0.0]), PERIOD)
    assert np.isnan([lower[0], upper[0]]).all()


@pytest.mark.parametrize("where", ["position", "velocity"])
@pytest.mark.parametrize("solver", ["daqp", "osqp", "proxqp"])
def test_a_state_that_is_not_finite_never_gives_torques(bench, solver, where):
    go2 = bench("go2", solver={"name": solver})
    good = go2.controller.solve(go2.state(), go2.references())
    q, v = np.array(go2.stance), np.zeros(go2.model.nv)
    if where == "position":
        q[go2.model.q_index[3]] = np.nan
    else:
        v[go2.model.v_index[3]] = np.nan
    with pytest.raises(NoSolution):
        go2.controller.solve(go2.state(q, v), go2.references())
    again = go2.controller.solve(go2.state(), go2.references())
    np.testing.assert_allclose(again.tau, good.tau, atol=0.01)
