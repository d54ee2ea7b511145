"""Robots with wrong axes or units of a sensor: refusal of the activation, or damping in the first motion."""

import numpy as np
import pytest

from wbc_controller.inverse_dynamics.robot.orientation import quaternion_of, rotation_of
from wbc_controller.records import Mode
from wbc_controller.simulation.faults.fault import LONGEST, Fault
from wbc_controller.validation.accuracy.estimation_trial import EstimationTrial

QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def accelerometer_with_the_wrong_sign(measured):
    measured.specific_force = -measured.specific_force


def imu_rotated_about_z(measured):
    measured.angular_velocity = QUARTER.T @ measured.angular_velocity
    measured.specific_force = QUARTER.T @ measured.specific_force


def gyroscope_in_deg(measured):
    measured.angular_velocity = np.degrees(measured.angular_velocity)


def facing_north(measured):
    """Turn the world of the odometry by 90°: correct odometry."""
    measured.pose[:3] = QUARTER @ measured.pose[:3]
    measured.pose[3:] = quaternion_of(QUARTER @ rotation_of(measured.pose[3:]))


def odometry_with_its_twist_in_the_world(measured):
    facing_north(measured)
    measured.twist = (rotation_of(measured.pose[3:]) @ measured.twist.reshape(2, 3).T).T.ravel()


def odometry_with_z_down(measured):
    facing_north(measured)
    turned = np.diag([1.0, -1.0, -1.0])
    measured.pose[3:] = quaternion_of(rotation_of(measured.pose[3:]) @ turned)
    measured.twist = (turned @ measured.twist.reshape(2, 3).T).T.ravel()


def sway(robot, spoil):
    """Activate, lower and sway a robot with a wrong sensor; return the refusal or fault, or an empty text."""

    class Spoiled(Fault):
        def _distort(self, measured, context, state):
            spoil(measured)

    base = "odom" if "odometry" in spoil.__name__ or spoil is facing_north else "imu"
    trial = EstimationTrial(robot, {"estimation.base_state": base, "mock.sensors": "good"})
    trial.mock.plan([Spoiled(duration=LONGEST)], since=0.0)
    trial.settle()
    trial.user.send_text("command", "activate")
    if trial.cycle().mode is not Mode.ACTIVE:
        return "; ".join(trial.report.refused)
    for i in range(round(2.2 * trial.settings.control.rate)):
        trial.cycle()
        if trial.report.fault is not None:
            return f"{trial.report.fault.code}: {trial.report.fault.sentence}"
        if i == round(0.4 * trial.settings.control.rate):
            trial.mock.plant.hold(False)
        if i == round(1.0 * trial.settings.control.rate):
            com = trial.reference_com()
            trial.follow([0.4, 0.8, 1.2], [com + [0.03, 0.045, 0.0], com - [0.03, 0.045, 0.0], com])
    return ""


@pytest.mark.parametrize(
    ("robot", "spoil", "said"),
    [
        ("g1", accelerometer_with_the_wrong_sign, ["'activate' is refused", "the accelerometer", "wrong sign"]),
        ("g1", imu_rotated_about_z, ["ESTIMATE_LOST", "the gyroscope contradicts the legs", "° about z"]),
        ("g1", gyroscope_in_deg, ["'activate' is refused", "varies by 0.", "gyroscope in deg/s"]),
        ("talos", odometry_with_its_twist_in_the_world, ["IMPLAUSIBLE_STATE", "twist", "axes of the world"]),
        ("g1", odometry_with_z_down, ["'activate' is refused", "of odometry", "z axis pointing down"]),
        ("g1", facing_north, []),
    ],
)
def test_the_wrong_axis_or_unit_is_named(robot, spoil, said):
    found = sway(robot, spoil)
    assert bool(found) == bool(said), found
    assert [part for part in said if part not in found] == []
