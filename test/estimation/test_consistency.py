"""Velocities of the contacts in the estimate against Pinocchio, and selection of contacts."""

import numpy as np
import pinocchio as pin
import pytest
from snapshots import dynamics_at

from wbc_controller.controller.build.estimation import make_leg_kinematics
from wbc_controller.controller.build.program import make_qp
from wbc_controller.estimation.consistency import LIMIT, ContactConsistency

OMEGA = np.zeros(3)


def make(robot_of, robot, frame):
    settings, model = robot_of(robot)
    legs = make_leg_kinematics(settings, model, make_qp(settings, model).contacts, frame)
    return settings, model, legs, ContactConsistency(legs)


@pytest.mark.parametrize(("robot", "frame"), [("g1", "torso_link"), ("go2", "base")])
def test_the_velocities_are_those_of_the_contact_points(robot_of, robot, frame):
    settings, model, legs, consistency = make(robot_of, robot, frame)
    rng = np.random.default_rng(0)
    base, twist = pin.SE3ToXYZQUAT(pin.SE3.Random()), 0.1 * rng.normal(size=6)
    q, v = model.state(model.posture, 0.1 * rng.normal(size=model.nj), base, twist)
    legs.update(q[model.q_index], v[model.v_index])
    dynamics, names, imu = dynamics_at(model, q, v), tuple(legs.points), model.frame_id(frame, "test")
    placement = dynamics.placement(imu)
    R = np.ascontiguousarray(placement.rotation)
    linear, angular = np.split(dynamics.velocity(imu, pin.LOCAL_WORLD_ALIGNED), 2)
    consistency.update(names, R, linear, R.T @ angular, np.inf)  # the mean is the present velocity
    speeds, seen = [], legs.contact_points(names)
    for i, name in enumerate(names):
        link = model.frame_id(settings.contacts[name].frame, "test")
        linear, angular = np.split(dynamics.velocity(link, pin.LOCAL_WORLD_ALIGNED), 2)
        points = placement.translation + seen.positions[slice(*np.append(0, seen.ends)[i : i + 2])] @ R.T
        lever = points - legs.rolling.get(name, np.zeros(3)) - dynamics.placement(link).translation
        speeds += np.linalg.norm(linear + np.cross(angular, lever), axis=1).tolist()
    assert consistency.speed == pytest.approx(min(speeds), rel=1e-9)
    assert consistency.speed > 0.0


def test_a_contact_that_holds_no_longer_counts_until_it_moves(robot_of):
    _, model, legs, consistency = make(robot_of, "g1", "pelvis")
    left, right = legs.points
    bent = np.zeros(model.nj)
    bent[model.joints.index("left_hip_pitch_joint")] = 0.5  # the left foot moves at some 0.3 m/s

    def pass_time(seconds, active_contacts, v, velocity=0.0):
        legs.update(model.posture, v)
        for _ in range(round(seconds / 0.01)):
            consistency.update(active_contacts, np.eye(3), np.array([velocity, 0.0, 0.0]), OMEGA, 0.01)

    pass_time(0.5, (left, right), bent)
    assert consistency.speed == 0.0
    pass_time(0.5, (left,), bent)
    assert consistency.speed == 0.0  # the right foot is unloaded and rests
    pass_time(0.5, (left,), bent, velocity=-0.2)
    assert consistency.speed > LIMIT
    pass_time(0.5, (left,), bent)  # the right foot has moved and no longer counts
    assert consistency.speed > LIMIT
    pass_time(0.01, (), bent)
    assert consistency.speed == 0.0


@pytest.mark.parametrize("weights", [(1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), (0.4, 0.3, 0.2, 0.1)])
@pytest.mark.parametrize("turn", [(0.0, 5.0, 0.0), (9.0, 1.0, 0.0)])
def test_a_sole_that_tips_over_a_corner_or_an_edge_below_it_rests_there(robot_of, weights, turn):
    _, model, legs, consistency = make(robot_of, "g1", "pelvis")
    (name, _), omega = legs.points, np.array(turn)
    place = weights @ (legs.corners[name] @ legs.contact_points((name,)).positions)
    legs.update(model.posture, np.zeros(model.nj))
    for _ in range(50):  # the robot turns as a rigid body about a place of the sole
        consistency.update((name,), np.eye(3), -np.cross(omega, place), omega, 0.01)
    assert consistency.speed < 1e-9
    rising = np.cross(omega, legs.contact_points((name,)).positions - place)[:, 2]
    np.testing.assert_allclose(consistency.tipping(name), np.abs(rising), atol=1e-6)
    assert consistency.tipping(name).max() > LIMIT
    for _ in range(50):  # and slides
        consistency.update((name,), np.eye(3), -np.cross(omega, place) + 0.2 * omega / max(turn), omega, 0.01)
    assert consistency.speed > LIMIT
    for _ in range(50):  # a sliding or lifted sole does not tip
        consistency.update((name,), np.eye(3), np.array([0.2, 0.0, 0.1]), OMEGA, 0.01)
    np.testing.assert_allclose(consistency.tipping(name), 0.0, atol=1e-6)


def test_neither_the_motion_before_a_touchdown_nor_a_wrong_sample_decides(robot_of):
    """A foot counts as a contact while it still moves; then it comes to rest, and the other foot lifts off."""
    _, model, legs, consistency = make(robot_of, "g1", "pelvis")
    (left, _) = legs.points
    legs.update(model.posture, np.zeros(model.nj))
    for _ in range(3):
        consistency.update((left,), np.eye(3), np.array([1.0, 0.0, 0.0]), OMEGA, 0.01)
    assert consistency.speed > LIMIT
    consistency.update((left,), np.eye(3), np.array([0.02, 0.0, 0.0]), OMEGA, 0.002)
    assert consistency.speed == pytest.approx(0.02)
    _, model, legs, consistency = make(robot_of, "g1", "pelvis")
    legs.update(model.posture, np.zeros(model.nj))
    consistency.update(tuple(legs.points), np.eye(3), np.array([0.0, 0.0, 50.0]), OMEGA, 0.002)
    assert consistency.speed == pytest.approx(1.0 - np.exp(-0.002 / 0.1))
    assert consistency.speed < LIMIT
