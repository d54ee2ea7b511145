"""Contact points relative to the IMU, their covariance and velocities."""

import numpy as np
import pinocchio as pin
import pytest
from snapshots import dynamics_at

from wbc_controller.controller.build.estimation import make_leg_kinematics
from wbc_controller.controller.build.program import make_qp
from wbc_controller.estimation.leg_kinematics import LegKinematics

FRAMES = {"g1": ("pelvis", "torso_link"), "talos": ("torso_2_link",), "go2": ("base",)}
NOISE = 0.5, 0.1
CASES = [(robot, frame) for robot, frames in FRAMES.items() for frame in frames]


def legs_of(robot_of, robot, frame):
    settings, model = robot_of(robot)
    frames = {name: contact.frame for name, contact in settings.contacts.items()}
    contacts = make_qp(settings, model).contacts
    return model, LegKinematics(model, contacts, frames, frame, joint_noise=NOISE[0], point_noise=NOISE[1])


@pytest.mark.parametrize(("robot", "frame"), CASES)
def test_covariance_and_velocities_are_those_of_places_that_change_with_the_joints(robot_of, robot, frame):
    model, legs = legs_of(robot_of, robot, frame)
    rng = np.random.default_rng(3)
    q, v, step = model.posture + 0.2 * rng.uniform(-1, 1, model.nj), rng.normal(size=model.nj), 1e-6
    names = tuple(legs.points)
    assert names
    J = np.empty((3 * sum(map(len, legs.points.values())), model.nj))
    for joint in range(model.nj):
        positions = []
        for sign in (1.0, -1.0):
            legs.update(q + sign * step * np.eye(model.nj)[joint], v)
            positions.append(legs.contact_points(names).positions)
        J[:, joint] = (positions[0] - positions[1]).ravel() / (2.0 * step)
    legs.update(q, v)
    expected, seen = NOISE[0] ** 2 * J @ J.T + NOISE[1] ** 2 * np.eye(len(J)), legs.contact_points(names)
    np.testing.assert_allclose(seen.covariance, expected, atol=1e-7)
    np.testing.assert_allclose(seen.velocities.ravel(), J @ v, atol=1e-7)
    start = 0
    for name in names:  # single contacts
        alone, end = legs.contact_points((name,)), start + len(legs.points[name])
        assert alone.names == legs.points[name] == seen.names[start:end]
        np.testing.assert_array_equal(alone.positions, seen.positions[start:end])
        own = slice(3 * start, 3 * end)
        np.testing.assert_allclose(alone.covariance, seen.covariance[own, own], rtol=1e-12, atol=1e-12)
        start = end


@pytest.mark.parametrize(("robot", "frame"), CASES)
def test_the_points_are_those_of_the_contacts_and_the_imu_is_where_the_urdf_says(robot_of, robot, frame):
    settings, model = robot_of(robot)
    _, legs = legs_of(robot_of, robot, frame)
    contacts = make_qp(settings, model).contacts
    rng = np.random.default_rng(4)
    q, v = model.posture + 0.2 * rng.uniform(-1, 1, model.nj), rng.normal(size=model.nj)
    base = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    dynamics, frame_id = dynamics_at(model, *model.state(q, v, base, np.zeros(6))), model.frame_id(frame, "test")
    legs.update(q, v)
    imu = dynamics.placement(frame_id)
    np.testing.assert_allclose(legs.imu_rotation, imu.rotation, atol=1e-12)
    np.testing.assert_allclose(legs.imu_position, imu.translation, atol=1e-12)
    np.testing.assert_allclose(legs.imu_motion, dynamics.velocity(frame_id, pin.LOCAL_WORLD_ALIGNED), atol=1e-12)
    for name, points in legs.points.items():
        expected = contacts[name].points(dynamics)[: len(points)] + legs.rolling.get(name, 0.0)
        seen = legs.contact_points((name,)).positions @ legs.imu_rotation.T + legs.imu_position
        np.testing.assert_allclose(seen, expected, atol=1e-12)
        link = model.frame_id(settings.contacts[name].frame, "test")
        turning = dynamics.velocity(link, pin.LOCAL_WORLD_ALIGNED)[3:]
        np.testing.assert_allclose(legs.contact_points((name,)).link_angular_velocities[0], turning, atol=1e-12)


def test_wheels_and_contacts_between_links_have_no_points(robot_of):
    settings, model = robot_of("go2")
    contacts = make_qp(settings, model).contacts
    (first, *others) = contacts
    contacts[first].internal = True
    assert list(make_leg_kinematics(settings, model, contacts, "base").points) == others
