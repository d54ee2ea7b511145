"""Joint motion kernel against NumPy."""

from collections import deque

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from wbc_controller.inverse_dynamics.limits import JointMotionLimit
from wbc_controller.inverse_dynamics.limits.joint_motion import VELOCITY_HORIZON
from wbc_controller.inverse_dynamics.limits.joint_motion_kernels import RETURN_TIME, STOPPING_DISTANCE

MANY = 2000


def plain_bounds(position, velocity, most, ahead, q, v, period):
    """`JointMotionLimit` in NumPy; the lower limit of q is an upper limit of -q."""
    speed, room = np.stack([v, -v]), np.stack([position[1] - q, q - position[0]])
    left, reach = room - 0.5 * ahead * speed, most * ahead
    bound = (np.sqrt(reach**2 + 2.0 * most * np.maximum(left, 0.0)) - reach - speed) / ahead
    spring, rounding = 4.0 / RETURN_TIME**2, 1.0e-11
    back = spring * np.maximum(room, -RETURN_TIME * velocity)
    back -= np.where(speed > 0.0, speed / period, spring * RETURN_TIME * speed)
    turning = -(speed**2) / np.where(room < rounding, 1.0, 2.0 * room)
    bound = np.where(left < -rounding, np.where(room < rounding, back, turning), bound)
    late, bound = bound < -most, np.minimum(np.maximum(bound, -most), most)
    with np.errstate(divide="ignore"):
        braking = np.where(room + STOPPING_DISTANCE > 0.0, -(speed**2) / (2.0 * (room + STOPPING_DISTANCE)), -np.inf)
    harder = np.maximum(braking, -speed / period)
    upper, lower = np.where(late & (harder < -most), harder, bound)
    lower = -lower
    crossed, up = lower > upper, v > 0.0
    lower, upper = np.where(crossed & up, upper, lower), np.where(crossed & ~up, lower, upper)
    slowing = max(period, min(ahead, VELOCITY_HORIZON))
    fast_down, fast_up = (velocity / slowing - each / np.where(each > 0.0, slowing, period) for each in (-v, v))
    return np.clip(np.clip(-fast_down, -most, most), lower, upper), np.clip(np.clip(fast_up, -most, most), lower, upper)


@given(
    seed=st.integers(0, 2**32 - 1),
    most=st.floats(10.0, 1000.0),
    period=st.floats(0.0005, 0.01),
    horizon=st.floats(0.0, 0.03),
    speeds=st.sampled_from([0.3, 3.0, 30.0]),
    widths=st.sampled_from([0.01, 1.0]),
    limited=st.booleans(),
    slowed=st.booleans(),
)
def test_kernel_equals_numpy(seed, most, period, horizon, speeds, widths, limited, slowed):
    rng = np.random.default_rng(seed)
    low = rng.uniform(-2.0, 0.0, MANY)
    high, velocity = low + rng.uniform(0.1, 2.0, MANY) * widths, rng.uniform(0.2, 2.0, MANY) * speeds
    q, v = rng.uniform(low - 0.1, high + 0.1), rng.normal(size=MANY) * speeds
    limit = JointMotionLimit(
        (low, high) if limited else None, velocity if slowed else None, acceleration=most, horizon=horizon
    )
    position = (low, high) if limited else (np.full(MANY, -np.inf), np.full(MANY, np.inf))
    fastest = velocity if slowed else np.full(MANY, np.inf)
    expected = plain_bounds(position, fastest, most, max(period, horizon), q, v, period)
    # Rounding errors of speed differences are divided by the period.
    rounding = 8.0 * np.finfo(float).eps * max(np.abs(v).max(), velocity.max()) / period
    np.testing.assert_allclose(limit.bounds(q, v, period), expected, rtol=1e-12, atol=rounding)


@given(
    seed=st.integers(0, 2**32 - 1),
    most=st.floats(10.0, 1000.0),
    period=st.floats(0.0005, 0.01),
    horizon=st.floats(0.0, 0.1),
    speeds=st.sampled_from([0.3, 3.0]),
)
def test_velocity_limit_permits_braking_and_return(seed, most, period, horizon, speeds):
    rng = np.random.default_rng(seed)
    low = rng.uniform(-2.0, 0.0, MANY)
    high, velocity = low + rng.uniform(0.5, 2.0, MANY), rng.uniform(0.2, 2.0, MANY) * speeds
    q, v = rng.uniform(low - 0.2, high + 0.2), rng.normal(size=MANY) * speeds
    alone = JointMotionLimit((low, high), None, acceleration=most, horizon=horizon).bounds(q, v, period)
    lower, upper = JointMotionLimit((low, high), velocity, acceleration=most, horizon=horizon).bounds(q, v, period)
    free = (alone[0] < alone[1]) & (np.abs(v) < velocity) & (np.abs(alone).max(axis=0) <= most)
    assert free.any()
    # A joint that reverses at its limit within the period needs more than a stop, the largest deceleration allowed.
    brakes = np.where(v > 0.0, alone[1] >= -v / period, alone[0] <= -v / period)
    assert (lower < upper)[free & brakes].all()


def test_velocity_limit_is_stable_with_delay():
    limit = JointMotionLimit(None, np.array([0.5]), acceleration=200.0, horizon=0.02)
    period, late, v = 0.002, deque([0.0] * 10), 0.6
    speeds = []
    for _ in range(1000):
        lower, upper = limit.bounds(np.zeros(1), np.array([v]), period)
        late.append(float(np.clip(1.0, lower[0], upper[0])))
        v += period * late.popleft()
        speeds.append(v)
    np.testing.assert_allclose(speeds[-200:], 0.5, atol=1e-6)
