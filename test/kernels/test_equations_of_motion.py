"""Held against the same equations in NumPy."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from wbc_controller.kernels import equations_of_motion as kernel

NV, NF, FREE, NA = 11, 4, 5, 6


@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1), selects=st.booleans())
def test_the_rows_are_projections_of_the_equations_of_motion(seed, selects):
    rng = np.random.default_rng(seed)
    root, J = rng.normal(size=(NV, NV)), rng.normal(size=(NF + 2, NV + 3))[1:-1, 2:-1]
    M, h, v, damping = np.asfortranarray(root @ root.T), *rng.normal(size=(2, NV)), rng.uniform(0.0, 30.0, NF)
    split = np.eye(NV)[rng.permutation(NV)] if selects else rng.normal(size=(NV, NV)) * (rng.random((NV, NV)) < 0.4)
    rows, columns = map(np.ascontiguousarray, split.nonzero())
    starts = np.searchsorted(rows, np.arange(NV + 1))
    memory = rng.normal(size=(NV, NV + NF + 1))  # of the last cycle
    motion, forces, right, bias = memory[:, :NV], memory[:, NV:-1], memory[:FREE, -1], np.empty(NA)
    contact_motion = rng.normal(size=NF)
    expected = contact_motion - damping * (J @ v)
    kernel.fill_rows(
        starts, columns, split[rows, columns], FREE, M, h, J, v, damping, 100.0,
        contact_motion, motion, forces, right, bias,
    )  # fmt: skip
    for found, wanted in (
        (contact_motion, expected), (motion, split @ M), (forces, -100.0 * split @ J.T),
        (right, -(split @ h)[:FREE]), (bias, (split @ h)[FREE:]),
    ):  # fmt: skip
        np.testing.assert_allclose(found, wanted, rtol=1e-10, atol=1e-9)


@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.0, 1.0))
def test_torques_change_by_a_share_of_their_limits_within_what_is_available(seed, share):
    rng = np.random.default_rng(seed)
    limits, before = rng.uniform(1.0, 100.0, 50), rng.normal(size=50) * 60.0
    before[3] = np.nan
    low, high = -limits * rng.random(50), limits * rng.random(50)
    lower, upper = np.empty(50), np.empty(50)
    kernel.rate_bounds(low, high, before, limits, share, lower, upper)
    held = np.clip(before, low, high)
    np.testing.assert_allclose(lower, np.maximum(low, held - share * limits), rtol=1e-14)
    np.testing.assert_allclose(upper, np.minimum(high, held + share * limits), rtol=1e-14)
