import numpy as np
import pinocchio as pin
import pytest
from snapshots import displacement

from wbc_controller.inverse_dynamics.references.trajectories import Knot, Ramp, SoftRamp, Trajectory
from wbc_controller.inverse_dynamics.robot.orientation import quaternion_of

SIZES = {"vector": 3, "joints": 9, "orientation": 3, "pose": 6}
JUST = 1.0e-9


def knot(kind, rng, time, speed=1.0):
    size, quaternion = SIZES[kind], quaternion_of(pin.exp3(rng.normal(size=3)))
    turned = {"orientation": quaternion, "pose": np.append(rng.normal(size=3), quaternion)}
    position = turned.get(kind, rng.normal(size=size))
    return Knot(time, position, speed * rng.normal(size=size), speed * rng.normal(size=size))


def journey(kind, seed):
    """Return three moving knots with rotations about different axes."""
    rng = np.random.default_rng(seed)
    return [knot(kind, rng, time) for time in (2.0, 2.7, 3.9)]


@pytest.mark.parametrize("kind", SIZES)
@pytest.mark.parametrize("seed", range(10))
def test_trajectory_interpolates_its_knots_with_exact_derivatives(kind, seed):
    knots = journey(kind, seed)
    trajectory = Trajectory(knots)
    for point, time in ((0, 2.0), (1, 2.7 - JUST), (1, 2.7), (1, 2.7 + JUST), (2, 3.9 - JUST)):
        reference = trajectory.sample(time)
        np.testing.assert_allclose(displacement(reference.position, knots[point].position), 0.0, atol=1e-6)
        np.testing.assert_allclose(reference.velocity, knots[point].velocity, atol=1e-5)
        np.testing.assert_allclose(reference.acceleration, knots[point].acceleration, atol=1e-4)
    step = 1.0e-5
    for time in np.linspace(2.01, 3.89, 15):
        before, here, after = (trajectory.sample(t) for t in (time - step, time, time + step))
        velocity = displacement(before.position, after.position) / (2.0 * step)
        acceleration = (after.velocity - before.velocity) / (2.0 * step)
        if kind in ("orientation", "pose"):
            assert np.linalg.norm(here.position[-4:]) == pytest.approx(1.0, abs=1e-9)
        np.testing.assert_allclose(here.velocity, velocity, atol=1e-6 * (1.0 + np.abs(acceleration).max()))
        if abs(time - 2.7) > step:
            scale = 1.0 + np.abs(here.acceleration).max()
            np.testing.assert_allclose(here.acceleration, acceleration, atol=1e-4 * scale)


@pytest.mark.parametrize("kind", SIZES)
def test_trajectory_rests_before_and_after(kind):
    knots = journey(kind, 0)
    trajectory = Trajectory(knots)
    for time, end in ((0.0, knots[0]), (1.999, knots[0]), (3.9, knots[2]), (100.0, knots[2]), (np.nan, knots[0])):
        reference = trajectory.sample(time)
        np.testing.assert_array_equal(reference.position, end.position)
        assert not reference.velocity.any()
        assert not reference.acceleration.any()
        assert reference.velocity.shape == (SIZES[kind],)


def test_rotations_are_geodesics_of_either_sign():
    rng = np.random.default_rng(1)
    a, b = (knot("orientation", rng, time, speed=0.0) for time in (0.0, 1.0))
    trajectory = Trajectory([a, b])
    whole = displacement(a.position, b.position)
    for time in np.linspace(0.0, 1.0, 11):
        share = 10 * time**3 - 15 * time**4 + 6 * time**5
        turned = displacement(a.position, trajectory.sample(time).position)
        np.testing.assert_allclose(turned, share * whole, atol=1e-9)
    a, b, c = journey("orientation", 4)
    flipped = Trajectory([a, Knot(b.time, -b.position, b.velocity, b.acceleration), c])
    for time in (2.3, 3.1):
        here, there = Trajectory([a, b, c]).sample(time), flipped.sample(time)
        np.testing.assert_allclose(displacement(here.position, there.position), 0.0, atol=1e-9)
        np.testing.assert_allclose(here.acceleration, there.acceleration, atol=1e-6)


def test_linear_and_soft_ramps():
    ramp = Ramp(start=1.0, duration=2.0, before=4.0, after=8.0)
    assert [ramp.sample(t) for t in (0.0, 1.0, 1.5, 2.0, 3.0, 9.0)] == [4.0, 4.0, 5.0, 6.0, 8.0, 8.0]
    assert Ramp(start=1.0, duration=0.0, before=4.0, after=8.0).sample(1.0) == 8.0
    ramp = SoftRamp(0.0, 0.5, 5.0, 0.0)
    steps = -np.diff([ramp.sample(0.002 * i) for i in range(252)])
    assert steps.min() >= 0.0
    assert steps[249] < 1e-6
    assert ramp.sample(0.5) == 0.0
    back = ramp.towards(5.0, 0.25, 0.5)
    assert isinstance(back, SoftRamp)
    assert back.sample(0.25) == pytest.approx(ramp.sample(0.25))
    assert SoftRamp(0.0, 0.0, 5.0, 2.0).sample(0.0) == 2.0
