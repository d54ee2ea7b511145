"""Held against the same equations in NumPy."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from wbc_controller.inverse_dynamics.robot import dynamics_kernels as kernel

NV, NF, FREE, NA = 11, 4, 5, 6


@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1), selects=st.booleans(), share=st.one_of(st.just(-1.0), st.floats(0.0, 1.0)))
def test_the_rows_are_projections_of_the_equations_of_motion(seed, selects, share):
    rng = np.random.default_rng(seed)
    root, h, v = rng.normal(size=(NV, NV)), *rng.normal(size=(2, NV))
    M, damping = root @ root.T, rng.uniform(0.0, 30.0, NF)
    split = np.eye(NV)[rng.permutation(NV)] if selects else rng.normal(size=(NV, NV)) * (rng.random((NV, NV)) < 0.4)
    rows, columns = map(np.ascontiguousarray, split.nonzero())
    starts = np.searchsorted(rows, np.arange(NV + 1))
    memory = rng.normal(size=(NF + 2 + NV, NV + NF + 1))  # of the last cycle; the contacts are new
    J, contact_motion = memory[:NF, :NV].copy(), memory[:NF, -1].copy()
    between = memory[NF : NF + 2].copy()
    limits, before = rng.uniform(1.0, 100.0, NA), rng.normal(size=NA) * 60.0
    before[3] = np.nan
    low, high = -limits * rng.random(NA), limits * rng.random(NA)
    lower, upper, bias = np.empty((3, NA))
    table = kernel.DynamicsRows(
        starts=starts, columns=columns, values=split[rows, columns], damping=damping, rows=memory, first=NF + 2,
        lower=lower, upper=upper, M=M, unit=100.0, available=np.stack([low, high, limits]), bias=bias,
    )  # fmt: skip
    kernel.fill_dynamics(table, h, v, before, share)
    filled, projected = memory[NF + 2 :], split @ h
    held, step = (before, np.inf) if share < 0.0 else (np.clip(before, low, high), share * limits)
    least, most = (low, high) if share < 0.0 else (np.maximum(low, held - step), np.minimum(high, held + step))
    for found, wanted in (
        (memory[:NF, -1], contact_motion - damping * (J @ v)), (memory[:NF, :NV], J), (memory[NF : NF + 2], between),
        (filled[:, :NV], split @ M), (filled[:, NV:-1], -100.0 * split @ J.T),
        (filled[:FREE, -1], -projected[:FREE]), (bias, projected[FREE:]),
        (lower, least - projected[FREE:]), (upper, most - projected[FREE:]),
    ):  # fmt: skip
        np.testing.assert_allclose(found, wanted, rtol=1e-10, atol=1e-9)
