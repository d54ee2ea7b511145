"""Held against the same equations in NumPy."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from wbc_controller.core.limits import JointMotionLimit
from wbc_controller.core.limits.joint_motion import RETURN_TIME, STOPPING

MANY = 2000


def plain_bounds(position, velocity, most, ahead, q, v, period):
    """As `JointMotionLimit` says it; the lower limit of q is an upper limit of -q."""
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
        braking = np.where(room + STOPPING > 0.0, -(speed**2) / (2.0 * (room + STOPPING)), -np.inf)
    harder = np.maximum(braking, -speed / period)
    upper, lower = np.where(late & (harder < -most), harder, bound)
    lower = -lower
    crossed, up = lower > upper, v > 0.0
    lower, upper = np.where(crossed & up, upper, lower), np.where(crossed & ~up, lower, upper)
    return (
        np.clip(np.clip((-velocity - v) / period, -most, most), lower, upper),
        np.clip(np.clip((velocity - v) / period, -most, most), lower, upper),
    )


@settings(deadline=None)
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
def test_it_is_what_numpy_makes_of_the_same_equations(seed, most, period, horizon, speeds, widths, limited, slowed):
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
    found = limit.bounds(q, v, period)
    np.testing.assert_allclose(found[0], expected[0], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found[1], expected[1], rtol=1e-12, atol=1e-12)


def test_what_is_not_finite_stays_so():
    limit = JointMotionLimit((np.full(3, -1.0), np.full(3, 1.0)), np.full(3, 5.0), acceleration=100.0)
    lower, upper = limit.bounds(np.array([0.0, np.nan, 0.0]), np.array([0.0, 0.0, np.inf]), 0.002)
    np.testing.assert_array_equal(np.isnan(lower), [False, True, True])
    np.testing.assert_array_equal(np.isnan(upper), [False, True, True])
