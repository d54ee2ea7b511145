"""The filter against the authors' implementation, its definitions, and its equations in NumPy."""

from collections.abc import Iterator

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plain_filter import PlainFilter

from wbc_controller.estimation.invariant_filter import InvariantFilter
from wbc_controller.inverse_dynamics.robot.orientation import heading_of
from wbc_controller.settings.estimation import EstimationSettings

GRAVITY = np.array([0.0, 0.0, -9.81])
FIELDS = ("gyroscope_noise", "accelerometer_noise", "gyroscope_bias_walk", "accelerometer_bias_walk", "contact_noise")


def noise_of(*densities):
    """Settings with densities that may be 0."""
    return EstimationSettings.model_construct(**dict(zip(FIELDS, densities, strict=True)))


NOISE = noise_of(0.01, 0.1, 1e-3, 1e-2, 0.05)
PERIOD = 0.002
STEPS = 300
NAMES = "abcdefgh"


def _start() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(7)
    P = np.diag(rng.uniform(1e-4, 1e-2, 15))
    turn, velocity, position, gyroscope, accelerometer = rng.normal(size=(5, 3))
    biases = {"gyroscope_bias": 0.01 * gyroscope, "accelerometer_bias": 0.1 * accelerometer}
    return {"rotation": pin.exp3(turn), "velocity": velocity, "position": position, **biases, "P": P}


#: Orientation, velocity, position, biases and covariance at the start.
START = _start()


def measurements() -> Iterator[tuple[np.ndarray, np.ndarray, tuple[bool, ...], np.ndarray, np.ndarray]]:
    """Yield random measurements of an IMU and three intermittent points.

    Angular velocity, specific force, active points, their positions (3, 3), and covariance (3, 3).
    """
    rng = np.random.default_rng(11)
    up = -START["rotation"].T @ GRAVITY
    active_contacts = ((True, True, False), (False, True, True), (True, False, True))
    for step in range(STEPS):
        positions = np.array([[0.1 * i, -0.2 + 0.2 * i, -0.9] for i in range(3)]) + 0.01 * rng.normal(size=(3, 3))
        turning, force = 0.5 * rng.normal(size=3), up + rng.normal(size=3)
        yield turning, force, active_contacts[step // 100], positions, 1e-4 * (np.eye(3) + 0.3 * np.ones((3, 3)))


#: State of the authors' implementation (github.com/RossHartley/invariant-ekf) after `measurements`: R by rows, v, p,
#: biases of gyroscope and accelerometer, and the trace of P.
THEIRS = [
    0.5133581445821527, -0.08085865948196004, -0.8543566542012485, -0.5258431330936647, 0.7571257875321722,
    -0.3876203570918733, 0.6781979171078361, 0.6482456471435609, 0.3461577186630676, 0.4820098317109099,
    -0.15091370061756854, -0.619934501757989, -0.2744410036324884, -1.541066134852788, 0.3473291240190481,
    -0.6074858218128493, 0.17592427492123905, -0.047728718025748205, -0.05914394599852427,
    -0.029493859115596294, 0.024220108949813062, 0.12663148064654403
]  # fmt: skip


def made(**changes):
    return InvariantFilter(NOISE, GRAVITY, **{**START, **changes})


def row(filter):
    biases = filter.gyroscope_bias, filter.accelerometer_bias
    return np.concatenate([filter.rotation.ravel(), filter.velocity, filter.position, *biases, [np.trace(filter.P)]])


def test_equal_to_the_authors_implementation():
    """The authors' code adds a point with the orientation before the correction of that step."""
    filter = made()
    for turning, force, active_contacts, positions, covariance in measurements():
        filter.propagate(turning, force, PERIOD)
        before = filter.rotation
        held = [i for i in range(3) if active_contacts[i] and str(i) in filter.names]
        if held:
            filter.correct([str(i) for i in held], positions[held], np.kron(np.eye(len(held)), covariance))
        back = filter.rotation.T @ before
        for i in range(3):
            if str(i) in filter.names and not active_contacts[i]:
                filter.remove(str(i))
            elif active_contacts[i] and str(i) not in filter.names:
                filter.add(str(i), back @ positions[i], back @ covariance @ back.T)
    np.testing.assert_allclose(row(filter), THEIRS, rtol=0.0, atol=1e-11)


def test_adding_and_removing_points():
    filter = made()
    before, P = row(filter), np.array(filter.P)
    covariance = 1e-4 * np.diag([1.0, 2.0, 3.0])
    filter.add("a", np.array([0.1, 0.0, -0.9]), 2.0 * covariance)
    filter.add("b", np.array([0.0, 0.2, -0.8]), covariance)
    R = filter.rotation
    np.testing.assert_allclose(filter.columns[:, 3], filter.position + R @ [0.0, 0.2, -0.8])
    apart = np.zeros((3, 21))
    apart[:, 6:9], apart[:, 12:15] = -np.eye(3), np.eye(3)
    np.testing.assert_allclose(apart @ filter.P @ apart.T, R @ covariance @ R.T, atol=1e-15)
    both, others = np.array(filter.P), [*range(12), *range(15, 21)]
    filter.remove("b")
    assert filter.names == ["a"]
    np.testing.assert_array_equal(filter.P, both[np.ix_(others, others)])
    filter.remove("a")
    np.testing.assert_array_equal(filter.P, P)
    np.testing.assert_array_equal(row(filter), before)


def test_a_correction_of_the_world_turns_and_shifts_alone():
    R, v, p, gyroscope, accelerometer, _ = START.values()
    half = np.random.default_rng(3).normal(size=(15, 15)) * 0.1
    found = made(P=half @ half.T)
    found.add("a", np.array([0.1, -0.2, -0.9]), 1e-4 * np.eye(3))
    at, noise, P = np.array([1.0, 2.0, 3.0]), 1e-2 * np.eye(4), found.P
    H = np.zeros((4, 18))
    H[:3, :3], H[:3, 6:9], H[3, 2] = -pin.skew(at), np.eye(3), 1.0
    point, z, level = found.columns[:, 2] - p, np.array([0.1, -0.2, 0.3, 0.05]), R[2]
    expected = H @ P @ H.T @ np.linalg.solve(H @ P @ H.T + noise, z)
    move = found.correct_world(H, z, noise, at)
    T, shift = move.rotation, move.translation
    np.testing.assert_allclose(np.append(move.act(at) - at, heading_of(move)), expected, atol=1e-12)
    np.testing.assert_allclose(found.rotation, T @ R, atol=1e-12)
    np.testing.assert_allclose(found.velocity, T @ v, atol=1e-12)
    np.testing.assert_allclose(found.position, T @ p + shift, atol=1e-12)
    np.testing.assert_allclose(found.columns[:, 2] - found.position, T @ point, atol=1e-12)
    np.testing.assert_allclose(found.accelerometer_bias, accelerometer)
    np.testing.assert_allclose(np.cross(found.gyroscope_bias - gyroscope, level), 0.0, atol=1e-12)
    after, before = np.linalg.eigvalsh(H @ found.P @ H.T), np.linalg.eigvalsh(H @ P @ H.T)
    np.testing.assert_allclose(  # as after a separate update
        H @ found.P @ H.T, np.linalg.inv(np.linalg.inv(H @ P @ H.T) + np.linalg.inv(noise)), atol=1e-9
    )
    assert (after < before).all()
    assert np.linalg.eigvalsh(found.P).min() > 0.0


@given(seed=st.integers(0, 2**32 - 1), points=st.integers(0, 8), kept=st.floats(0.0, 1.0))
def test_equal_to_numpy(seed, points, kept):
    rng = np.random.default_rng(seed)
    root, w = rng.normal(size=(15, 15)), rng.normal(size=3)
    begin = {
        "rotation": pin.exp3(w), "velocity": rng.normal(size=3), "position": rng.normal(size=3),
        "gyroscope_bias": 0.1 * rng.normal(size=3), "accelerometer_bias": 0.1 * rng.normal(size=3),
        "P": 0.01 * root @ root.T,
    }  # fmt: skip
    noise = noise_of(*rng.uniform(0.01, 1.0, 5))
    found, plain = (kind(noise, GRAVITY, **begin) for kind in (InvariantFilter, PlainFilter))
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


def with_point():
    found = made()
    found.add("a", np.zeros(3), np.eye(3))
    return found


def test_indefinite_covariances_are_refused():
    filter = with_point()
    before = filter.P.copy()
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        filter.correct(["a"], np.ones((1, 3)), np.diag([1.0, -10.0, 1.0]))
    np.testing.assert_array_equal(filter.P, before)


@pytest.mark.parametrize(("place", "noise"), [(np.nan, 1.0), (1.0, np.nan)])
def test_no_correction_by_non_finite_values(place, noise):
    filter = with_point()
    before = filter.P.copy()
    assert np.isnan(filter.correct(["a"], np.full((1, 3), place), np.diag([1.0, noise, 1.0]))).all()
    np.testing.assert_array_equal(filter.P, before)
