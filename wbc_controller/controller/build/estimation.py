"""Builds the estimators from the settings: base, contacts, joint velocities, disturbance, friction."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from wbc_controller.errors import ConfigurationError, valid_choices
from wbc_controller.estimation.absolute_pose import PoseSensor
from wbc_controller.estimation.base_estimator import BaseEstimator, Sensors
from wbc_controller.estimation.contact_detection import ContactSensing, DetectionLimits
from wbc_controller.estimation.contact_forces import ContactForces
from wbc_controller.estimation.disturbance_observer import DisturbanceLimits, DisturbanceObserver
from wbc_controller.estimation.friction import FrictionCompensation
from wbc_controller.estimation.invariant_filter import ImuNoise
from wbc_controller.estimation.joint_velocity import VelocityFilter, delay
from wbc_controller.estimation.leg_kinematics import LegKinematics
from wbc_controller.estimation.model_error import ModelErrorCompensation
from wbc_controller.estimation.odometry_agreement import OdometryAgreement
from wbc_controller.inverse_dynamics.contacts import (
    Contact,
    FixedContact,
    PointContact,
    SurfaceContact,
    UnilateralContact,
)
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array
from wbc_controller.settings import Settings


def imu_frame(settings: Settings, model: RobotModel) -> str:
    """Return the frame of the robot's IMU."""
    return settings.estimation.imu_frame or model.base_link


def pose_frame(settings: Settings, model: RobotModel) -> str:
    """Return the frame of the robot whose absolute poses are measured."""
    return settings.estimation.pose_frame or model.base_link


def torque_filter(settings: Settings) -> float:
    """Return the time constant of the torque filter, s; 0 without a filter."""
    known = settings.estimation
    asked = known.torque_filter == "always" or (known.torque_filter == "imu" and known.base_state == "imu")
    return known.torque_filter_time if asked else 0.0


def disturbance_limits(settings: Settings) -> DisturbanceLimits:
    """Return speed and size of the disturbance estimate."""
    known = settings.estimation
    asked = known.disturbance == "always" or (known.disturbance == "imu" and known.base_state == "imu")
    return DisturbanceLimits(known.disturbance_time, known.disturbance_share, asked)


def make_model_error(settings: Settings, model: RobotModel, contacts: Mapping[str, Contact]) -> ModelErrorCompensation:
    """Make the compensation of known friction and of the observed disturbance.

    Raises:
        ConfigurationError: if a joint with friction is unknown.
    """
    friction = settings.robot.friction
    for joint in friction:
        if joint not in model.joints:
            raise ConfigurationError(f"robot.friction.{joint}: {valid_choices(joint, model.joints)}")
    known = (
        FrictionCompensation(
            model,
            {joint: each.dry for joint, each in friction.items()},
            {joint: each.viscous for joint, each in friction.items()},
        )
        if friction
        else None
    )
    observer = DisturbanceObserver(model, disturbance_limits(settings))
    contact_forces = None
    if estimates_base(settings, model):
        limits = detection_limits(settings, model)
        normals = {name: each.normal for name, each in contacts.items() if isinstance(each, UnilateralContact)}
        contact_forces = ContactForces(normals, limits.on, limits.off)
    return ModelErrorCompensation(observer, known, contact_forces, 1.0 / settings.control.rate)


def make_velocity_filter(settings: Settings) -> VelocityFilter | None:
    """Make the filter of joint velocities; None if they are measured."""
    known = settings.estimation
    return VelocityFilter(known.joint_velocity_time) if known.joint_velocity == "differentiated" else None


def velocity_delay(settings: Settings) -> float:
    """Return the delay of the joint velocities, s; 0 if they are measured."""
    known = settings.estimation
    return delay(known.joint_velocity_time, 1.0 / settings.control.rate) if make_velocity_filter(settings) else 0.0


def estimates_base(settings: Settings, model: RobotModel) -> bool:
    """Return whether the controller estimates its floating base itself."""
    return settings.estimation.base_state == "imu" and model.floating_base


def make_leg_kinematics(
    settings: Settings, model: RobotModel, contacts: Mapping[str, Contact], frame: str
) -> LegKinematics:
    """Make the kinematics from a frame of a sensor to the contacts of the configuration.

    Raises:
        ConfigurationError: if the robot has no such frame.
    """
    return LegKinematics(
        model,
        contacts,
        {name: contact.frame for name, contact in settings.contacts.items()},
        frame,
        joint_noise=settings.estimation.joint_position_noise,
        point_noise=settings.estimation.contact_position_noise,
    )


def make_odometry_agreement(
    settings: Settings, model: RobotModel, contacts: Mapping[str, Contact]
) -> OdometryAgreement | None:
    """Make the comparison of odometry with the legs; None without odometry, or without contacts to compare with."""
    if not model.floating_base or estimates_base(settings, model):
        return None
    legs = make_leg_kinematics(settings, model, contacts, model.base_link)
    return OdometryAgreement(legs) if legs.points else None


def make_estimator(settings: Settings, model: RobotModel, contacts: Mapping[str, Contact]) -> BaseEstimator:
    """Make the estimator of a floating base.

    Raises:
        ConfigurationError: if the base is fixed, the IMU has no frame, or no contact has fixed points.
    """
    known = settings.estimation
    if not model.floating_base:
        raise ConfigurationError(f"robot.base = {settings.robot.base!r}: there is no base to estimate; Valid: floating")
    legs = make_leg_kinematics(settings, model, contacts, imu_frame(settings, model))
    if not legs.points:
        raise ConfigurationError(
            "the base cannot be estimated: no contact of the configuration stays where it is (surface, point, fixed; "
            "not wheels, and not contacts between two links); take estimation.base_state = 'odom'"
        )
    noise = ImuNoise(
        known.gyroscope_noise,
        known.accelerometer_noise,
        known.gyroscope_bias_walk,
        known.accelerometer_bias_walk,
        known.contact_noise,
    )
    sensors = Sensors(noise, known.accelerometer_bias, known.settling, known.stillness)
    poses = (
        PoseSensor(pose_frame(settings, model), known.pose_noise, known.pose_turn_noise)
        if known.absolute_pose
        else None
    )
    return BaseEstimator(legs, sensors, np.array(model.pinocchio.gravity.linear), poses)


def detection_limits(settings: Settings, model: RobotModel) -> DetectionLimits:
    """Return the limits of forces at the contacts that hold."""
    known, weight = settings.estimation, model.mass * model.gravity
    return DetectionLimits(known.contact_force_on * weight, known.contact_force_off * weight, known.contact_timeout)


def make_sensing(settings: Settings, model: RobotModel, contacts: Mapping[str, Contact]) -> ContactSensing:
    """Make the parameters of the sensors at the contacts."""
    return ContactSensing(contact_normals(model, contacts), detection_limits(settings, model))


def contact_normals(model: RobotModel, contacts: Mapping[str, Contact]) -> dict[str, dict[str, Array]]:
    """Return the normal of each contact in the axes of each frame in which its force may be measured, (3,) each.

    These frames are the contact's own (named after it, or unnamed); for soles and held links all frames of the link;
    for balls and wheels, which rotate against the ground, the world.
    """
    dynamics, frames = Dynamics(model), model.pinocchio.frames
    normals: dict[str, dict[str, Array]] = {}
    for name, contact in contacts.items():
        own = {"": np.array([0.0, 0.0, 1.0]), name: np.array([0.0, 0.0, 1.0])}
        if isinstance(contact, SurfaceContact | FixedContact):
            normal = contact.placement(dynamics).rotation[:, 2]
            link = frames[model.frame_id(contact.wrench_frame, f"contacts.{name}.frame")].parentJoint
            fixed = {f.name: i for i, f in enumerate(frames) if f.parentJoint == link}
            own = {frame: dynamics.placement(i).rotation.T @ normal for frame, i in fixed.items()} | own
        elif isinstance(contact, PointContact) and not contact.internal:
            own["world"] = contact.axes(dynamics)[:, 2]
        normals[name] = own
    return normals
