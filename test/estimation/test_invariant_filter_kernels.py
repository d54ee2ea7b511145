"""Kernels against the equations in NumPy."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plain_filter import PlainFilter

from wbc_controller.estimation.invariant_filter import ImuNoise, InvariantFilter

NAMES = "abcdefgh"


@given(seed=st.integers(0, 2**32 - 1), points=st.integers(0, 8), kept=st.floats(0.0, 1.0))
def test_equal_to_numpy(seed, points, kept):
    rng = np.random.default_rng(seed)
    root, w = rng.normal(size=(15, 15)), rng.normal(size=3)
    begin = {
        "rotation": pin.exp3(w), "velocity": rng.normal(size=3), "position": rng.normal(size=3),
        "gyroscope_bias": 0.1 * rng.normal(size=3), "accelerometer_bias": 0.1 * rng.normal(size=3),
        "P": 0.01 * root @ root.T,
    }  # fmt: skip
    noise = ImuNoise(*rng.uniform(0.01, 1.0, 5))
    found, plain = (kind(noise, np.array([0.0, 0.0, -9.81]), **begin) for kind in (InvariantFilter, PlainFilter))
    noisy = rng.normal(size=(3 * points, 3 * points))
    covariance, positions = 1e-2 * (noisy @ noisy.T + np.eye(3 * points)), rng.normal(size=(points, 3))
    for i, name in enumerate(NAMES[:points]):
        own = covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
        found.add(name, positions[i], own)
        plain.add(name, positions[i], own)
    at = np.flatnonzero(rng.random(points) < kept)
    rows = (3 * at[:, None] + np.arange(3)).ravel()
    names, moved = [NAMES[i] for i in at], positions[at] + 0.1 * rng.normal(size=(len(at), 3))
    for _ in range(3):
        turning, force = rng.normal(size=(2, 3)) * rng.choice([1e-9, 1.0, 10.0])
        creep = rng.uniform(0.01, 1.0, points)
        for filter in (found, plain):
            filter.propagate(turning, force, 0.01, creep)
        if names:
            noisy = covariance[np.ix_(rows, rows)]
            z, S = plain.innovation(names, moved, noisy)
            ends = np.array(sorted({*rng.integers(1, len(names) + 1, 3).tolist(), len(names)}))
            parts = [slice(3 * start, 3 * end) for start, end in zip([0, *ends], ends, strict=False)]
            expected = np.array([z[own] @ np.linalg.solve(S[own, own], z[own]) for own in parts])
            before = found.P
            refused = found.correct(names, moved, noisy, ends=ends, limits=expected * (1.0 - 1e-3))
            np.testing.assert_allclose(refused, expected, rtol=1e-6)
            assert found.P is before
            squares = found.correct(names, moved, noisy, ends=ends, limits=expected * (1.0 + 1e-3))
            np.testing.assert_array_equal(squares, refused)
            plain.correct(names, z, S)
        for part in ("rotation", "columns", "gyroscope_bias", "accelerometer_bias", "P"):
            wanted = getattr(plain, part)
            np.testing.assert_allclose(getattr(found, part), wanted, atol=1e-9 * (1.0 + np.abs(wanted).max()))
    if names:
        np.testing.assert_array_equal(found.P, found.P.T)


def still():
    found = InvariantFilter(
        ImuNoise(0.1, 0.1, 0.1, 0.1, 0.1), np.array([0.0, 0.0, -9.81]), rotation=np.eye(3), velocity=np.zeros(3),
        position=np.zeros(3), gyroscope_bias=np.zeros(3), accelerometer_bias=np.zeros(3), P=np.eye(15),
    )  # fmt: skip
    found.add("a", np.zeros(3), np.eye(3))
    return found


def test_indefinite_covariances_are_refused():
    filter = still()
    before = filter.P.copy()
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        filter.correct(["a"], np.ones((1, 3)), np.diag([1.0, -10.0, 1.0]))
    np.testing.assert_array_equal(filter.P, before)


@pytest.mark.parametrize(("place", "noise"), [(np.nan, 1.0), (1.0, np.nan)])
def test_no_correction_by_non_finite_values(place, noise):
    filter = still()
    before = filter.P.copy()
    squares = filter.correct(["a"], np.full((1, 3), place), np.diag([1.0, noise, 1.0]))
    assert np.isnan(squares).all()
    np.testing.assert_array_equal(filter.P, before)
