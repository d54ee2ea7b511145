"""The base estimator of a robot, from its settings."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from wbc_controller.core.contacts import Contact
from wbc_controller.core.robot.model import RobotModel
from wbc_controller.errors import ConfigurationError
from wbc_controller.estimation.base_estimator import BaseEstimator, Sensors
from wbc_controller.estimation.invariant_filter import ImuNoise
from wbc_controller.estimation.leg_kinematics import LegKinematics
from wbc_controller.settings import Settings


def imu_frame(settings: Settings, model: RobotModel) -> str:
    """Frame of the robot's IMU."""
    return settings.estimation.imu_frame or model.base_link


def make_estimator(settings: Settings, model: RobotModel, contacts: Mapping[str, Contact]) -> BaseEstimator | None:
    """Make the estimator of a floating base; None where its state is measured elsewhere, or the base is fixed.

    Args:
        settings: the robot's settings.
        model: its model.
        contacts: its contacts, by name.

    Raises:
        ConfigurationError: where the IMU has no frame, or no contact could carry an estimate.
    """
    known = settings.estimation
    if known.base_state == "odom" or not model.floating_base:
        return None
    frames = {name: contact.frame for name, contact in settings.contacts.items()}
    legs = LegKinematics(model, contacts, frames, imu_frame(settings, model))
    if not legs.points:
        raise ConfigurationError(
            "estimation.base_state = 'imu': no contact of the configuration stays where it is (surface, point, fixed; "
            "not wheels, and not contacts between two links), so that nothing holds the estimate; take odom"
        )
    noise = ImuNoise(
        known.gyroscope_noise,
        known.accelerometer_noise,
        known.gyroscope_bias_walk,
        known.accelerometer_bias_walk,
        known.contact_noise,
    )
    sensors = Sensors(
        noise,
        known.joint_position_noise,
        known.contact_position_noise,
        known.accelerometer_bias,
        known.settling,
        known.stillness,
    )
    return BaseEstimator(legs, sensors, np.array(model.pinocchio.gravity.linear))
