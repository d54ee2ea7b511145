"""Where the IMU sees the contact points, and how that changes with the joints."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from wbc_controller.assembly.program import make_qp
from wbc_controller.estimation.leg_kinematics import LegKinematics

FRAMES = {"g1": ("pelvis", "torso_link"), "talos": ("torso_2_link",), "go2": ("base",)}
CASES = [(robot, frame) for robot, frames in FRAMES.items() for frame in frames]


def legs_of(robot_of, robot, frame):
    settings, model = robot_of(robot)
    frames = {name: contact.frame for name, contact in settings.contacts.items()}
    return model, LegKinematics(model, make_qp(settings, model).contacts, frames, frame)


@pytest.mark.parametrize(("robot", "frame"), CASES)
def test_the_jacobian_is_the_change_of_the_places(robot_of, robot, frame):
    model, legs = legs_of(robot_of, robot, frame)
    rng = np.random.default_rng(3)
    q, v, step = model.posture + 0.2 * rng.uniform(-1, 1, model.nj), rng.normal(size=model.nj), 1e-6
    assert legs.points
    for name in legs.points:
        legs.update(q, v)
        sight = legs.sight(name)
        places = []
        for sign in (1.0, -1.0):
            legs.update(q + sign * step * v, v)
            places.append(legs.sight(name).places)
        rate = (places[0] - places[1]).ravel() / (2.0 * step)
        np.testing.assert_allclose(sight.jacobian @ v[np.argsort(model.v_index)], rate, atol=1e-7)


@pytest.mark.parametrize(("robot", "frame"), CASES)
def test_the_points_are_those_of_the_contacts_and_the_imu_is_where_the_urdf_says(robot_of, robot, frame):
    settings, model = robot_of(robot)
    _, legs = legs_of(robot_of, robot, frame)
    contacts = make_qp(settings, model).contacts
    rng = np.random.default_rng(4)
    q, v = model.posture + 0.2 * rng.uniform(-1, 1, model.nj), rng.normal(size=model.nj)
    base = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    whole, moving = model.state(q, v, base, np.zeros(6))
    dynamics = make_qp(settings, model).dynamics
    dynamics.update(whole, moving)
    legs.update(q, v)
    imu = dynamics.placement(model.frame_id(frame, "test"))
    np.testing.assert_allclose(legs.imu_rotation, imu.rotation, atol=1e-12)
    np.testing.assert_allclose(legs.imu_position, imu.translation, atol=1e-12)
    twist = dynamics.velocity(model.frame_id(frame, "test"), pin.LOCAL_WORLD_ALIGNED)
    np.testing.assert_allclose(np.concatenate(legs.imu_motion()), twist, atol=1e-12)
    for name, points in legs.points.items():
        expected = contacts[name].points(dynamics)[: len(points)] + legs.rolling.get(name, 0.0)
        seen = legs.sight(name).places @ legs.imu_rotation.T + legs.imu_position
        np.testing.assert_allclose(seen, expected, atol=1e-12)
        link = model.frame_id(settings.contacts[name].frame, "test")
        turning = dynamics.velocity(link, pin.LOCAL_WORLD_ALIGNED)[3:]
        np.testing.assert_allclose(legs.sight(name).turning, turning, atol=1e-12)


def test_wheels_and_contacts_between_links_have_no_points(robot_of):
    settings, model = robot_of("go2")
    frames = {name: contact.frame for name, contact in settings.contacts.items()}
    contacts = make_qp(settings, model).contacts
    (first, *others) = contacts
    contacts[first].internal = True
    legs = LegKinematics(model, contacts, frames, "base")
    assert list(legs.points) == others
