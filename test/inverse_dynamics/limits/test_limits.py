from types import SimpleNamespace

import numpy as np
import pytest
from demands import demand

from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.limits import JointMotionLimit, TorqueLimit, TorqueSpeedCurve
from wbc_controller.inverse_dynamics.limits.joint_motion_kernels import STOPPING_DISTANCE
from wbc_controller.inverse_dynamics.robot.dynamics_kernels import DynamicsRows, fill_dynamics
from wbc_controller.records import Tuning
from wbc_controller.settings.limits import ActuatorTorqueSpeed, TorqueSpeedSettings

PERIOD = 0.002
ELBOW = "left_elbow_joint"

# Viability: with any demand, a joint never reaches a state without feasible bounds -----------------------------------

MANY = 5_000


def fastest(room, acceleration, ahead):
    """Return the largest viable speed towards a limit at a distance."""
    reach = 0.5 * acceleration * ahead
    return np.sqrt(reach**2 + 2.0 * acceleration * room) - reach


def adversaries(rng):
    """Return a function that picks accelerations between the bounds: up, down, outwards, in turns or at random."""
    kind, side = rng.integers(5, size=MANY), rng.random(MANY) < 0.5

    def pick(lower, upper, v):
        nonlocal side
        side = side ^ (rng.random(MANY) < 0.05)
        high = np.select([kind == 0, kind == 1, kind == 2], [np.full(MANY, True), np.full(MANY, False), v > 0.0], side)
        return np.where(kind == 4, rng.uniform(lower, upper), np.where(high, upper, lower))

    return pick


def excess(q, v, a, period, low, high):
    """Return the largest violation of position limits within one period, with turning points."""
    turn = np.clip(np.divide(-v, a, out=np.zeros_like(v), where=a != 0.0), 0.0, period)
    passed = np.stack([q + t * v + 0.5 * t**2 * a for t in (turn, period)])
    return max(np.max(passed - high), np.max(low - passed))


@pytest.mark.parametrize(
    ("period", "horizon", "acceleration"),
    [(0.001, 0.0, 500.0), (0.002, 0.02, 30.0), (0.005, 0.02, 500.0), (0.005, 0.0, 30.0)],
)
def test_viable_states_keep_all_bounds(period, horizon, acceleration):
    rng = np.random.default_rng(1)
    low, high = -rng.uniform(0.05, 3.0, MANY), rng.uniform(0.05, 3.0, MANY)
    velocity = rng.uniform(0.2, 40.0, MANY)
    limit = JointMotionLimit((low, high), velocity, acceleration=acceleration, horizon=horizon)
    start = rng.uniform(low, high)
    up = np.minimum(velocity, fastest(high - start, acceleration, max(period, horizon)))
    down = np.minimum(velocity, fastest(start - low, acceleration, max(period, horizon)))
    begin = np.where(rng.random(MANY) < 0.3, np.where(rng.random(MANY) < 0.5, up, -down), rng.uniform(-down, up))
    assert np.mean(begin == up) > 0.1
    q, v, pick, closest = start, begin, adversaries(rng), np.inf
    for _ in range(200):
        lower, upper = limit.bounds(q, v, period)
        assert (lower <= upper).all()
        a = pick(lower, upper, v)
        assert np.max(np.abs(a)) <= acceleration
        assert excess(q, v, a, period, low, high) <= 1.0e-6
        q = q + period * v + 0.5 * period**2 * a  # exact
        v = v + period * a
        assert np.max(np.abs(v) - velocity) <= 1.0e-6
        closest = np.minimum(closest, np.minimum(high - q, q - low))
    assert np.mean(closest < 5.0e-3) > 0.1  # the limit was active


@pytest.mark.parametrize("period", [0.001, 0.005])
def test_position_limit_holds_for_states_with_braking_distance(period):
    rng = np.random.default_rng(2)
    low, high, velocity = np.full(MANY, -1.0), np.full(MANY, 1.0), np.full(MANY, 5.0)
    limit = JointMotionLimit((low, high), velocity, acceleration=200.0)
    q = rng.uniform(low, high)
    v = np.minimum(velocity, np.sqrt(400.0 * (high - q))) * (1.0 - 1.0e-12)
    for _ in range(200):
        _, upper = limit.bounds(q, v, period)
        assert excess(q, v, upper, period, low, high) <= 1.0e-6
        q, v = q + period * v + 0.5 * period**2 * upper, v + period * upper
        assert np.max(np.abs(v) - velocity) <= 1.0e-6


def hard_braking(q, v, period):
    """Return the deceleration of a joint that stops just beyond its limit of 1, at most a stop within a period."""
    room = 1.0 + STOPPING_DISTANCE - np.sign(v) * q
    needed = np.where(room > 0.0, v**2 / (2.0 * np.maximum(room, 1e-300)), np.inf)
    return np.maximum(100.0, np.minimum(needed, np.abs(v) / period))


@pytest.mark.parametrize("period", [0.001, 0.005])
def test_return_from_non_viable_states(period):
    rng = np.random.default_rng(3)
    low, high, velocity = np.full(MANY, -1.0), np.full(MANY, 1.0), np.full(MANY, 4.0)
    limit = JointMotionLimit((low, high), velocity, acceleration=100.0)
    q, v = rng.uniform(-1.5, 1.5, MANY), rng.uniform(-15.0, 15.0, MANY)
    beyond = np.sign(q) * np.maximum(np.abs(q) - 1.0, 0.0)
    for i in range(int(3.0 / period)):
        lower, upper = limit.bounds(q, v, period)
        assert (lower <= upper).all()
        hardest = hard_braking(q, v, period)
        assert (np.abs([lower, upper]) <= hardest * (1.0 + 1e-12)).all()
        if i == 0:
            away = (beyond * v > 0.0) & (np.abs(v) > 100.0 * period)
            fast = (np.abs(v) > 4.0 + 100.0 * period) & (beyond == 0.0)
            assert away.sum() > 0.1 * MANY
            assert fast.sum() > 0.1 * MANY
            assert 0.1 * MANY < (hardest > 100.0).sum() < 0.9 * MANY
            for hard in (away, fast):
                np.testing.assert_allclose(np.where(v > 0.0, upper, lower)[hard], -(hardest * np.sign(v))[hard])
        a = np.where(q > 0.0, upper, lower)  # outwards
        q, v = q + period * v + 0.5 * period**2 * a, v + period * a
    assert np.max(np.abs(q)) <= 1.0 + 1.0e-6
    assert np.max(np.abs(v)) <= 4.0 + 1.0e-6


def test_limits_are_not_conservative():
    """With full demand, a joint moves between its limits nearly as fast as q̈_max allows."""
    limit = JointMotionLimit((-np.ones(1), np.ones(1)), np.full(1, 100.0), acceleration=100.0)
    q, v, cycles = np.array([-1.0]), np.zeros(1), 0
    while q[0] < 1.0 - 1.0e-4 and cycles < 10_000:
        _, upper = limit.bounds(q, v, PERIOD)
        q, v = q + PERIOD * v + 0.5 * PERIOD**2 * upper, v + PERIOD * upper
        cycles += 1
    shortest = 2.0 * np.sqrt(2.0 / 100.0)
    assert cycles * PERIOD < shortest + 0.03


def test_longer_horizon_reduces_the_effect_of_noise():
    q, v, noise = np.array([0.999]), np.zeros(1), 1.0e-4
    change = {}
    for horizon in (0.0, 0.02):
        limit = JointMotionLimit((-np.ones(1), np.ones(1)), np.full(1, 10.0), acceleration=200.0, horizon=horizon)
        change[horizon] = limit.bounds(q - noise, v, PERIOD)[1] - limit.bounds(q + noise, v, PERIOD)[1]
    assert 0.0 < change[0.02] < 0.1 * change[0.0]


def test_contradicting_position_limits_are_refused():
    tuning = Tuning(
        {}, position_margin=0.2, position_horizon=0.0, velocity_scale=1.0, acceleration=1.0, torque_rate=1.0
    )

    def gripper(lower, followers=None):
        return SimpleNamespace(
            joints=("wrist", "finger"),
            units=("rad", "m"),
            position_lower=np.array([-1.0, lower]),
            position_upper=np.array([1.0, 0.3]),
            velocity_limits=np.ones(2),
            followers=followers,
        )

    sentence = "position_margin = 0.2 leaves no range for 'finger', with the limits 0 and 0.3 m"
    with pytest.raises(ConfigurationError, match=f"{sentence}$"):
        JointMotionLimit.of(gripper(0.0), tuning)
    with pytest.raises(ConfigurationError, match=f"{sentence}, also of mimic joints$"):
        JointMotionLimit.of(gripper(0.0, ["thumb"]), tuning)
    with pytest.raises(ConfigurationError, match="finger"):
        JointMotionLimit.of(gripper(np.nan), tuning)
    assert JointMotionLimit.of(gripper(-0.3), tuning).position[1] == pytest.approx([0.8, 0.1])
    assert JointMotionLimit.of(gripper(0.0), tuning, position=False).position is None


def test_position_precedes_velocity():
    position = JointMotionLimit((np.array([-1.0]), np.array([1.0])), None, acceleration=500.0)
    velocity = JointMotionLimit(None, np.array([2.0]), acceleration=500.0)
    both = JointMotionLimit((np.array([-1.0]), np.array([1.0])), np.array([2.0]), acceleration=500.0)
    q, v = np.array([3.0]), np.array([-3.0])  # far beyond the limit, and returning too fast
    assert velocity.bounds(q, v, PERIOD)[0] > position.bounds(q, v, PERIOD)[1]  # disjoint intervals
    lower, upper = both.bounds(q, v, PERIOD)
    assert lower == upper
    assert upper < velocity.bounds(q, v, PERIOD)[0]


def torque_bounds(limit, before, v, period):
    """Return the torque bounds of a robot of massless joints."""
    n, available = len(v), limit.available(v)
    lower, upper, bias, each = np.empty(n), np.empty(n), np.empty(n), np.arange(n + 1)
    share = -1.0 if before is None else limit.rate * period
    table = DynamicsRows(
        starts=each, columns=each[:-1], values=np.ones(n), damping=np.zeros(0), rows=np.zeros((n, n + 1)), first=0,
        lower=lower, upper=upper, M=np.zeros((n, n)), unit=1.0, available=np.stack([*available, limit.effort_limits]),
        bias=bias,
    )  # fmt: skip
    before = v if before is None else before
    fill_dynamics(table, np.zeros(n), v, before, share)
    return lower, upper


def test_torque_bounds():
    limit, v = TorqueLimit(np.array([10.0, 20.0]), rate=5.0), np.array([3.0, -4.0])
    np.testing.assert_array_equal(torque_bounds(limit, None, v, 0.01), ([-10.0, -20.0], [10.0, 20.0]))
    lower, upper = torque_bounds(limit, np.array([0.0, 19.5]), v, 0.01)
    np.testing.assert_allclose(lower, [-0.5, 18.5])
    np.testing.assert_allclose(upper, [0.5, 20.0])
    # A torque beyond its limit returns at once: the interval is never empty, nor beyond the limit.
    lower, upper = torque_bounds(limit, np.array([300.0, -300.0]), v, 0.01)
    np.testing.assert_allclose(lower, [9.5, -20.0])
    np.testing.assert_allclose(upper, [10.0, -19.0])


# Torque-speed curve --------------------------------------------------------------------------------------------------

CURVE = TorqueSpeedCurve(np.full(3, 4.0), np.full(3, 10.0))
EFFORT = np.array([10.0, 20.0, 30.0])


@pytest.mark.parametrize(("speed", "share"), [(0.0, 1.0), (4.0, 1.0), (7.0, 0.5), (10.0, 0.0), (25.0, 0.0)])
def test_torque_speed_curve(speed, share):
    forwards, backwards = (CURVE.available(EFFORT, np.full(3, v)) for v in (speed, -speed))
    np.testing.assert_allclose(forwards[1], share * EFFORT)
    np.testing.assert_array_equal(forwards[0], -EFFORT)  # a braking motor has its full torque
    np.testing.assert_allclose(backwards[0], -share * EFFORT)
    np.testing.assert_array_equal(backwards[1], EFFORT)


def test_curve_and_rate_never_conflict():
    rng = np.random.default_rng(4)
    for rate in (0.1, 5.0, 1.0e4):
        limit = TorqueLimit(EFFORT, rate, CURVE)
        for _ in range(500):
            v, before = rng.uniform(-15.0, 15.0, 3), rng.uniform(-2.0, 2.0, 3) * EFFORT
            available, (lower, upper) = limit.available(v), torque_bounds(limit, before, v, PERIOD)
            assert (available[0] <= lower).all()
            assert (lower <= upper).all()
            assert (upper <= available[1]).all()
            inside = np.clip(before, *available) == before
            assert (np.maximum(upper - before, before - lower) <= rate * PERIOD * EFFORT + 1e-9)[inside].all()


def test_torque_speed_curve_has_an_effect(bench):
    """An elbow at half of its largest speed has a quarter of its torque; without the curve it needs more."""
    free, tau = {"position": False, "velocity": False, "acceleration": 1.0e5}, {}
    curve = TorqueSpeedSettings(enabled=True, corner=0.2, no_load=0.6)
    for name, limits in (("held", {**free, "torque_speed": curve}), ("free", free)):
        robot = bench("g1", limits=limits)
        model, v = robot.model, np.zeros(robot.model.nv)
        i = model.joints.index(ELBOW)
        v[model.v_index[i]] = 0.5 * model.velocity_limits[i]
        references = demand(robot.references(posture=1000.0), "posture", acceleration=2000.0 * np.eye(model.na)[i])
        solution = robot.controller.solve(robot.state(v=v), references)
        tau[name] = solution.tau[i] / model.effort_limits[i]
        assert f"torque:{ELBOW}:upper" in solution.binding
    assert tau == pytest.approx({"held": 0.25, "free": 1.0}, abs=1e-5)


def test_torque_speed_curves_per_actuator(bench):
    own = ActuatorTorqueSpeed(corner=3.0, no_load=5.0)
    g1 = bench("g1", limits={"torque_speed": TorqueSpeedSettings(enabled=True, actuators={ELBOW: own})})
    curve, i = g1.controller.formulation.torque_limit.curve, g1.model.joints.index(ELBOW)
    assert (curve.corner[i], curve.no_load[i]) == (3.0, 5.0)
    others = np.arange(g1.model.na) != i
    np.testing.assert_allclose(curve.corner[others], 0.5 * g1.model.velocity_limits[others])
    np.testing.assert_allclose(curve.no_load[others], g1.model.velocity_limits[others])


def test_nan_passes_through_the_bounds():
    motion = JointMotionLimit((-np.ones(2), np.ones(2)), np.ones(2), acceleration=500.0)
    for q, v in (([np.nan, 0.0], [0.0, 0.0]), ([0.0, 0.0], [np.nan, 0.0])):
        lower, upper = motion.bounds(np.array(q), np.array(v), PERIOD)
        assert np.isnan([lower[0], upper[0]]).all()
        assert np.isfinite([lower[1], upper[1]]).all()
    lower, upper = torque_bounds(TorqueLimit(np.ones(2), 1.0), np.array([np.nan, 0.0]), np.zeros(2), PERIOD)
    assert np.isnan([lower[0], upper[0]]).all()
    lower, upper = CURVE.available(EFFORT, np.array([np.nan, 0.0, 0.0]))
    assert np.isnan([lower[0], upper[0]]).all()
    assert np.isfinite([lower[1:], upper[1:]]).all()


# Stopping bounds of a joint that cannot meet its bounds --------------------------------------------------------------


LIMITS = np.array([-1.0, -1.0]), np.array([1.0, 1.0])


def stopping(limit, q, v):
    """Return the bounds of the first of two joints; the other one is at rest in the middle."""
    q, v = np.array([q, 0.0]), np.array([v, 0.0])
    return limit.stopping_bounds(q, v, np.stack(limit.bounds(q, v, PERIOD)), LIMITS)[:, 0]


@pytest.mark.parametrize(("side", "gap", "speed"), [(1.0, 0.1, 3.0), (-1.0, 0.02, 2.0), (-1.0, 0.3, 8.0)])
def test_stopping_bounds_stop_within_the_stopping_distance(side, gap, speed):
    limit = JointMotionLimit((LIMITS[0] + 0.02, LIMITS[1] - 0.02), None, acceleration=200.0, horizon=0.02)
    q, v = side * (1.0 - gap), side * speed
    for _ in range(500):
        if side * v <= 0.0:
            break
        bounds = stopping(limit, q, v)
        a = bounds[1] if side > 0.0 else -bounds[0]
        assert a < 0.0
        q, v = q + PERIOD * v + 0.5 * PERIOD**2 * side * a, v + PERIOD * side * a
    assert side * v <= 0.0
    # Bounds change once per period, so the last period may exceed it.
    assert 1.0 + 0.5 * STOPPING_DISTANCE < side * q < 1.0 + STOPPING_DISTANCE + 1e-3


def test_stopping_bounds_are_not_tighter_than_the_bounds():
    limit = JointMotionLimit((LIMITS[0] + 0.02, LIMITS[1] - 0.02), np.full(2, 5.0), acceleration=200.0)
    rng = np.random.default_rng(0)
    for _ in range(500):
        q, v = rng.uniform(-1.05, 1.05), rng.uniform(-6.0, 6.0)
        whole = np.stack(limit.bounds(np.array([q, 0.0]), np.array([v, 0.0]), PERIOD))
        lower, upper = stopping(limit, q, v)
        assert lower <= whole[0, 0]
        assert upper >= whole[1, 0]
        assert lower == -np.inf or v < 0.0
        assert upper == np.inf or v > 0.0


def test_stopping_bounds_beyond_the_stopping_distance():
    limit = JointMotionLimit((LIMITS[0], LIMITS[1]), None, acceleration=200.0)
    assert stopping(limit, 1.0 + STOPPING_DISTANCE + 0.01, 2.0)[1] == -2.0 / PERIOD
    assert stopping(limit, -1.0 - STOPPING_DISTANCE - 0.01, -2.0)[0] == 2.0 / PERIOD
    limit = JointMotionLimit(None, np.full(2, 5.0), acceleration=200.0)  # without position limits
    np.testing.assert_array_equal(stopping(limit, 0.99, 4.0), [-np.inf, np.inf])
