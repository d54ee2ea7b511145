"""Held against the same equations in NumPy; `test/diagnostics/test_audit.py` holds both against `mechanics`."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from wbc_controller.kernels import audit as kernel

NV, NA, GAP, SHARE = 9, 5, 0.002, 0.1


@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1), floating=st.booleans(), springs=st.booleans())
def test_it_is_what_numpy_makes_of_the_same_equations(seed, floating, springs):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(NV, NV))
    M, J = np.asfortranarray(root @ root.T), rng.normal(size=(6, NV))[:3]
    v, v_after, v_dot, moved, torques = rng.normal(size=(5, NV))
    gravity, com, velocity, drift, force = rng.normal(size=(5, 3))
    out = np.empty(6)
    energy = kernel.mechanical_state(M, v, v_dot, gravity, 7.0, com, velocity, J, drift, out)
    np.testing.assert_allclose(energy, 0.5 * v @ M @ v - gravity @ com, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(out, [*(7.0 * velocity), *(7.0 * (J @ v_dot + drift))], rtol=1e-10, atol=1e-12)

    tau, S, passive = rng.normal(size=NA), rng.normal(size=(NA, NV)), rng.normal(size=NV if springs else 0)
    powers = (tau @ S + (passive if springs else 0.0)) * moved / GAP
    found = kernel.joint_powers(tau, S, passive, moved, GAP)
    np.testing.assert_allclose(found, [powers.sum(), np.abs(powers).sum()], rtol=1e-10, atol=1e-9)

    before, after = rng.normal(size=(2, 6))
    expected = torques + SHARE * (M @ ((v_after - v) / GAP - v_dot) - torques)
    unexplained = force + SHARE * ((after[:3] - before[:3]) / GAP - before[3:] - force)
    force = force if floating else force[:0]
    kernel.filter_residuals(SHARE, GAP, M, v, v_after, v_dot, before, after, force, torques)
    np.testing.assert_allclose(torques, expected, rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(force, unexplained[: len(force)], rtol=1e-10, atol=1e-9)
