"""Held against the same equations in NumPy; `test/safety/test_model_audit.py` holds both against `mechanics`."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wbc_controller.compiled import Bound
from wbc_controller.safety import model_audit_kernels as kernel

NV, NA, GAP, TIME, MASS = 9, 5, 0.002, 0.02, 7.0


def test_the_energy_is_that_of_motion_and_height():
    rng = np.random.default_rng(0)
    root, v = rng.normal(size=(NV, NV)), rng.normal(size=NV)
    M, weight, com = root @ root.T, *rng.normal(size=(2, 3))
    energy = kernel.mechanical_energy(Bound(NV, 0, 0, 0, M, com, weight).table, v)
    assert energy == pytest.approx(0.5 * v @ M @ v - weight @ com, rel=1e-10)


@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1), floating=st.booleans(), beside=st.booleans(), sent=st.lists(st.booleans()))
def test_a_span_is_what_numpy_makes_of_the_same_equations(seed, floating, beside, sent):
    rng = np.random.default_rng(seed)
    base = 6 if floating else 0
    S = np.zeros((NA, NV))
    S[:, base:] = rng.normal(size=(NA, NV - base)) * rng.integers(0, 2, size=(NA, NV - base))
    rows, columns = (np.ascontiguousarray(index) for index in np.nonzero(S))
    sums, vectors = np.zeros(kernel.SUMS), np.zeros((2, NV))
    velocity, drift, jacobian = np.zeros(3), np.zeros(3), np.zeros((NV, 6))
    drives = rows.astype(np.int64), columns.astype(np.int64), S[rows, columns]
    sizes, memory = (len(rows), NV + bool(base), NV, NA), np.full(3 * NV + bool(base) + NA, np.nan)
    bound = Bound(*sizes, *drives, np.array([MASS]), velocity, jacobian, drift, sums, vectors, memory)
    work = throughput = duration = 0.0
    impulse, missed, before = np.zeros(3), np.zeros(NV), None
    for predicts in [True, *sent]:
        q, v, v_dot, tau = (rng.normal(size=n) for n in (NV + bool(base), NV, NV, NA))
        velocity[:], drift[:] = rng.normal(size=(2, 3))
        jacobian[:] = rng.normal(size=(NV, 6))
        J = jacobian.T[:3]
        p = rng.normal(size=NV) if beside else np.zeros(0)
        moved = np.zeros(NV)
        if before is not None:
            moved[base:] = (q - before["q"])[len(q) - NV + base :]
            if beside:
                moved[:base] = rng.normal(size=base)
        said = kernel.follow(
            bound.table, 0.0 if before is None else GAP, p, moved if beside else np.zeros(0), q, v, v_dot, tau,
            tau if predicts else tau + [*np.zeros(NA - 1), 0.1],
        )  # fmt: skip
        assert said == predicts
        if before is not None:
            done = (before["tau"] @ S + (p if beside else 0.0)) * moved
            work, throughput = work + done.sum(), throughput + np.abs(done).sum()
            if before["predicts"]:
                duration += GAP
                impulse += MASS * (velocity - before["velocity"]) - GAP * before["force"]
                missed += v - before["v"] - GAP * before["v_dot"]
        before = {"q": q, "v": v, "v_dot": v_dot, "tau": tau, "velocity": velocity.copy(), "predicts": predicts}
        before["force"] = MASS * (J @ v_dot + drift)
    found = sums[[kernel.WORK, kernel.THROUGHPUT, kernel.PREDICTED]]
    np.testing.assert_allclose(found, [work, throughput, duration], rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(sums[kernel.IMPULSE : kernel.IMPULSE + 3], impulse, rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(vectors[0], missed, rtol=1e-10, atol=1e-9)

    root, v, numbers = rng.normal(size=(NV, NV)), rng.normal(size=NV), rng.normal(size=3)
    M, torques, force = root @ root.T, rng.normal(size=NV), rng.normal(size=3 if floating else 0)
    weight, com, limits = rng.normal(size=3), rng.normal(size=3), 1.0 + rng.random(NA)
    to_joints = rng.normal(size=(NA, NV)) * rng.integers(0, 2, size=(NA, NV))
    joints, components = (index.astype(np.int64) for index in np.nonzero(to_joints))
    expected, unexplained = torques.copy(), force.copy()
    if duration > 0.0:
        share = duration / (TIME + duration)
        expected += share * (M @ missed / duration - torques)
        unexplained += share * ((impulse / duration)[: len(force)] - force)
    kept = sums[kernel.MOMENTUM :].copy()
    factors, constant = to_joints[joints, components], np.array([TIME])
    bound = Bound(
        NV, NA, len(joints), len(force), M, com, weight, components, joints, factors, limits, sums, vectors, force,
        torques, constant,
    )  # fmt: skip
    found, lasted = np.full(3 + NA, np.nan), 3 * GAP
    energy, *means, size, most, worst = kernel.look_back(bound.table, lasted, v, *numbers, found)
    assert energy == pytest.approx(0.5 * v @ M @ v - weight @ com, rel=1e-10)
    share = lasted / (TIME + lasted)
    rates = np.array([energy - numbers[0] - work, throughput]) / lasted
    np.testing.assert_allclose(means, (1.0 - share) * numbers[1:] + share * rates, rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(torques, expected, rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(force, unexplained, rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(found[:3], unexplained if floating else np.zeros(3), rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(found[3:], to_joints @ expected, rtol=1e-9, atol=1e-8)
    assert size == pytest.approx(np.linalg.norm(force), rel=1e-10)
    over = np.abs(found[3:]) / limits
    assert (most, worst) == (over.max(), over.argmax())
    assert not sums[: kernel.MOMENTUM].any()
    assert not vectors[0].any()
    assert sums[kernel.MOMENTUM :].tolist() == kept.tolist()
