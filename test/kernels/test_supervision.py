"""Held against the same equations in NumPy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wbc_controller.kernels import supervision as kernel

N = 12
seeds = st.integers(0, 2**32 - 1)


@pytest.mark.parametrize("value", [1.0, -1.0, 1.0 + 1e-15, -1.1, np.nan, np.inf, -np.inf])
def test_values_at_their_limits_are_within_and_what_is_not_finite_never_is(value):
    values = np.zeros(N)
    values[7] = value
    assert kernel.within(values, np.ones(N)) == (abs(value) <= 1.0)
    assert kernel.within(values[::-1], np.ones(N)) == (abs(value) <= 1.0)


@settings(deadline=None)
@given(seed=seeds, spoilt=st.sampled_from([0.0, np.nan, np.inf]), size=st.sampled_from([0.3, 1.0, 1.2]))
def test_torques_are_usable_up_to_a_share_of_their_limits_beyond_what_is_available(seed, spoilt, size):
    rng = np.random.default_rng(seed)
    limits, ends = rng.uniform(1.0, 20.0, N), rng.uniform(-size, size, N)
    lower, upper, tau = -limits, 0.9 * limits, ends * limits
    tau[3] += spoilt
    expected = ((tau >= lower - 0.05 * limits) & (tau <= upper + 0.05 * limits)).all()
    assert kernel.usable(tau, lower, upper, limits, 0.05) == expected


@settings(deadline=None)
@given(seed=seeds, size=st.sampled_from([0.1, 1.0, 10.0]), spoilt=st.booleans())
def test_the_mismatch_is_what_numpy_makes_of_the_same_equations(seed, size, spoilt):
    rng = np.random.default_rng(seed)
    change, before, v, found = rng.normal(size=(4, N))
    change[rng.random(N) < 0.2] = 0.0
    if spoilt:
        v[3] = np.nan
    expected = 0.9 * found + (change - 0.5 * 0.02 * (before + v))
    tolerance = np.full(N, 2.0 * size)
    good, still = kernel.mismatch(change, before, v, 0.02, 0.9, found, tolerance)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-14)
    assert good == (np.abs(expected) <= tolerance).all()
    assert still == np.count_nonzero(change == 0.0)


@settings(deadline=None)
@given(seed=seeds)
def test_torques_change_by_a_step_and_what_is_available_takes_precedence(seed):
    rng = np.random.default_rng(seed)
    tau, before, limits = 30.0 * rng.normal(size=(3, N))
    tau[2], step, limits = np.nan, rng.uniform(0.0, 20.0, N), np.abs(limits)
    out = np.empty(N)
    kernel.limited(tau, before, step, -limits, limits, out)
    np.testing.assert_array_equal(out, np.clip(np.clip(tau, before - step, before + step), -limits, limits))


@settings(deadline=None)
@given(seed=seeds)
def test_what_is_ahead_is_the_end_of_a_period(seed):
    rng = np.random.default_rng(seed)
    q, v, v_dot = rng.normal(size=N + 1), rng.normal(size=N), rng.normal(size=N)
    v_index = rng.permutation(N)[:7]
    q_out, v_out = np.empty(7), np.empty(7)
    kernel.ahead(q, v, v_dot, v_index + 1, v_index, 0.002, q_out, v_out)
    np.testing.assert_allclose(v_out, (v + 0.002 * v_dot)[v_index], rtol=1e-14)
    np.testing.assert_allclose(q_out, q[v_index + 1] + 0.002 * v_out, rtol=1e-14)
