"""Sensor errors of the mock robot: noise densities, biases, resolution, torque errors."""

import math
from typing import get_args

import numpy as np
import pytest
from peer import MockPeer
from refusals import refusal

from wbc_controller.middleware.transports.memory import MemoryBus
from wbc_controller.settings.service import SensorQuality
from wbc_controller.simulation.mock_robot import MockRobot
from wbc_controller.simulation.plant import Plant
from wbc_controller.simulation.sensors import PARTS, ImperfectSensors, Measurement

PERIOD, MANY = 0.002, 4000


@pytest.fixture(scope="module")
def standing(robot_of):
    settings, model = robot_of("go2")
    plant = Plant(model, settings)
    return model, lambda stamp: Measurement(model, plant, stamp, model.base_link)


@pytest.mark.parametrize("quality", PARTS)
def test_noise_is_of_the_stated_density_and_biases_stay(standing, quality):
    (model, look), parts = standing, PARTS[quality]
    sensors = ImperfectSensors(parts, model, PERIOD, 3)
    errors = {name: [] for name in ("angular_velocity", "specific_force", "position", "velocity")}
    for i in range(MANY):
        measured, true = look(i), look(i)
        sensors.measure(measured)
        for name, of in errors.items():
            of.append(getattr(measured, name) - getattr(true, name))
    deviation = {name: np.std(np.diff(of, axis=0), axis=0) / math.sqrt(2.0) for name, of in errors.items()}
    np.testing.assert_allclose(deviation["angular_velocity"], parts.gyroscope_noise / math.sqrt(PERIOD), rtol=0.06)
    np.testing.assert_allclose(deviation["specific_force"], parts.accelerometer_noise / math.sqrt(PERIOD), rtol=0.06)
    np.testing.assert_allclose(deviation["velocity"], parts.velocity_noise, rtol=0.06)
    rounding = parts.encoder_resolution / math.sqrt(12.0)
    np.testing.assert_allclose(deviation["position"], math.hypot(parts.encoder_noise, rounding), rtol=0.15)
    for name, size in (
        ("angular_velocity", parts.gyroscope_bias),
        ("specific_force", parts.accelerometer_bias),
        ("position", parts.encoder_offset),
    ):
        assert 0.2 * size < np.abs(np.mean(errors[name], axis=0)).max() < 4.0 * size, name
    assert np.abs(np.mean(errors["velocity"], axis=0)).max() < 0.1 * parts.velocity_noise


def test_the_same_seed_and_time_measure_the_same_and_each_motor_has_an_error(standing):
    model, look = standing
    first, second, other = (ImperfectSensors(PARTS["good"], model, PERIOD, seed) for seed in (5, 5, 6))
    seen = []
    for sensors in (first, second, other, first):
        seen.append(look(0))
        sensors.measure(seen[-1])
    np.testing.assert_array_equal(seen[0].specific_force, seen[1].specific_force)
    np.testing.assert_array_equal(seen[0].position, seen[3].position)
    assert (seen[0].specific_force != seen[2].specific_force).all()
    later = look(1)
    first.measure(later)
    assert (later.specific_force != seen[0].specific_force).all()
    np.testing.assert_array_equal(later.pose, seen[0].pose)  # odometry stays true
    ImperfectSensors(PARTS["cheap"], model, PERIOD, 0).measure(later)
    steps = later.position / (2.0 * math.pi / 2**14)  # of the encoder
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    tau = np.linspace(-20.0, 20.0, model.na)
    sent = ImperfectSensors(PARTS["cheap"], model, PERIOD, 0).torques(tau)
    errors = sent[tau != 0.0] / tau[tau != 0.0] - 1.0
    assert 0.01 < np.abs(errors).max() < 0.5
    np.testing.assert_allclose(ImperfectSensors(PARTS["cheap"], model, PERIOD, 0).torques(2.0 * tau), 2.0 * sent)


@pytest.mark.parametrize("quality", ["ideal", "good"])
def test_the_mock_robot_measures_and_pulls_as_its_parts_do(robot_of, changed, quality):
    assert {*PARTS, "ideal"} == {*get_args(SensorQuality)}
    settings, model = robot_of("go2")
    peer = MockPeer(MemoryBus(), settings)
    robot = MockRobot(model, changed(settings, {"mock": {"sensors": quality}}), peer.transport)
    robot._tau, robot._tau_time = np.linspace(1.0, 2.0, model.na), 0.0
    robot.advance()
    off = np.abs(robot.plant.applied_torques / robot._tau - 1.0).max()
    assert (off == 0.0) == (quality == "ideal")
    assert off < 0.1
    robot.publish()
    off = np.abs(peer.all("joint_states")[0].position - robot.plant.state()[0][model.q_index]).max()
    assert (off == 0.0) == (quality == "ideal")
    assert off < 0.01


def test_it_may_measure_no_joint_velocities_and_needs_the_link_of_the_imu(robot_of, changed):
    settings, model = robot_of("go2")
    peer = MockPeer(MemoryBus(), settings)
    assert "nose" in refusal(MockRobot, model, changed(settings, {"estimation": {"imu_frame": "nose"}}), peer.transport)
    MockRobot(model, changed(settings, {"mock": {"joint_velocity": False}}), peer.transport).publish()
    (content,) = peer.all("joint_states")
    assert len(content.velocity) == 0
    assert len(content.position) == model.nj
