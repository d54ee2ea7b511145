"""Construction of the estimators."""

import math
from collections.abc import Mapping

import numpy as np

from wbc_controller.errors import ConfigurationError, require_known
from wbc_controller.estimation.base_estimator import BaseEstimator
from wbc_controller.estimation.contact_detection import ContactDetector, ContactForces
from wbc_controller.estimation.disturbance_observer import DisturbanceLimits, DisturbanceObserver
from wbc_controller.estimation.friction import FrictionCompensation
from wbc_controller.estimation.joint_velocity import VelocityFilter
from wbc_controller.estimation.leg_kinematics import LegKinematics
from wbc_controller.estimation.model_error import ModelErrorCompensation
from wbc_controller.estimation.sensor_agreement import OdometryAgreement
from wbc_controller.inverse_dynamics import contacts as kinds
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array
from wbc_controller.safety.supervisor import FILTERED_RATE
from wbc_controller.settings import Settings

Contacts = Mapping[str, kinds.Contact]


def imu_frame(settings: Settings, model: RobotModel) -> str:
    """Return the IMU frame."""
    return settings.estimation.imu_frame or model.base_link


def pose_frame(settings: Settings, model: RobotModel) -> str:
    """Return the frame of absolute poses."""
    return settings.estimation.pose_frame or model.base_link


def torque_filter(settings: Settings) -> float:
    """Return the time constant of the torque filter, s; 0 without a filter."""
    known = settings.estimation
    return known.torque_filter_time if known.torque_filter in ("always", known.base_state) else 0.0


def solution_torque_rate(settings: Settings) -> float:
    """Return the rate limit of the solutions' torques, in effort limits per second.

    The torque filter passes the share 1 - e^{-Δt/τ} of their difference to the present torques.
    """
    filter_time = torque_filter(settings)
    if filter_time <= 0.0:
        return settings.limits.torque_rate
    return FILTERED_RATE * settings.limits.torque_rate / -math.expm1(-1.0 / (settings.control.rate * filter_time))


def disturbance_limits(settings: Settings) -> DisturbanceLimits:
    """Return time constant and bound of the disturbance estimate."""
    known = settings.estimation
    enabled = known.disturbance in ("always", known.base_state)
    return DisturbanceLimits(known.disturbance_time, known.disturbance_share, enabled)


def make_model_error(settings: Settings, model: RobotModel, contacts: Contacts) -> ModelErrorCompensation:
    """Build the compensation of friction and disturbance."""
    friction = settings.robot.friction
    require_known(friction, model.joints, "robot.friction: unknown joint")
    dry = {joint: each.dry for joint, each in friction.items()}
    viscous = {joint: each.viscous for joint, each in friction.items()}
    known = FrictionCompensation(model, dry, viscous) if friction else None
    observer = DisturbanceObserver(model, disturbance_limits(settings))
    contact_forces = None
    if estimates_base(settings, model):
        normals = {name: each.normal for name, each in contacts.items() if isinstance(each, kinds.UnilateralContact)}
        contact_forces = ContactForces(normals, *force_thresholds(settings, model))
    return ModelErrorCompensation(observer, known, contact_forces, 1.0 / settings.control.rate)


def make_velocity_filter(settings: Settings) -> VelocityFilter | None:
    """Build the filter of differentiated joint velocities; None if they are measured."""
    known = settings.estimation
    return VelocityFilter(known.joint_velocity_time) if known.joint_velocity == "differentiated" else None


def estimates_base(settings: Settings, model: RobotModel) -> bool:
    """Return True if the controller estimates its floating base."""
    return settings.estimation.base_state == "imu" and model.floating_base


def make_leg_kinematics(settings: Settings, model: RobotModel, contacts: Contacts, frame: str) -> LegKinematics:
    """Build the kinematics from a sensor frame to the contacts."""
    known, frames = settings.estimation, {name: contact.frame for name, contact in settings.contacts.items()}
    return LegKinematics(
        model, contacts, frames, frame, joint_noise=known.joint_position_noise, point_noise=known.contact_position_noise
    )


def make_odometry_agreement(settings: Settings, model: RobotModel, contacts: Contacts) -> OdometryAgreement | None:
    """Build the comparison of odometry and leg kinematics; None without odometry or contacts."""
    if not model.floating_base or estimates_base(settings, model):
        return None
    legs = make_leg_kinematics(settings, model, contacts, model.base_link)
    return OdometryAgreement(legs) if legs.points else None


def make_estimator(settings: Settings, model: RobotModel, contacts: Contacts) -> BaseEstimator:
    """Build the estimator of a floating base."""
    known = settings.estimation
    if not model.floating_base:
        raise ConfigurationError(f"robot.base = {settings.robot.base!r}: base estimation requires 'floating'")
    legs = make_leg_kinematics(settings, model, contacts, imu_frame(settings, model))
    if not legs.points:
        raise ConfigurationError(
            "the base cannot be estimated: no contact is fixed to the world (surface, point or fixed; not rolling, and "
            "not between two links); use estimation.base_state = 'odom'"
        )
    poses = pose_frame(settings, model) if known.absolute_pose else None
    return BaseEstimator(legs, known, np.array(model.pinocchio.gravity.linear), poses)


def make_contact_detector(settings: Settings, model: RobotModel, contacts: Contacts) -> ContactDetector:
    """Build the detector of contacts by force sensors and switches."""
    on, off = force_thresholds(settings, model)
    return ContactDetector(contact_normals(model, contacts), on, off, settings.estimation.contact_timeout)


def force_thresholds(settings: Settings, model: RobotModel) -> tuple[float, float]:
    """Return the normal forces that activate and deactivate a contact, N."""
    known, weight = settings.estimation, model.mass * model.gravity
    return known.contact_force_on * weight, known.contact_force_off * weight


def contact_normals(model: RobotModel, contacts: Contacts) -> dict[str, dict[str, Array]]:
    """Return the normal of each contact, (3,), in each frame in which its force may be measured.

    Frames: the contact's own (its name, or unnamed); for surface and fixed contacts all frames of the link; for points
    and wheels, which rotate, the world.
    """
    dynamics, frames = Dynamics(model), model.pinocchio.frames
    normals: dict[str, dict[str, Array]] = {}
    for name, contact in contacts.items():
        own = {"": np.array([0.0, 0.0, 1.0]), name: np.array([0.0, 0.0, 1.0])}
        if isinstance(contact, kinds.SurfaceContact | kinds.FixedContact):
            normal = contact.placement(dynamics).rotation[:, 2]
            link = frames[model.frame_id(contact.wrench_frame, f"contacts.{name}.frame")].parentJoint
            fixed = {f.name: i for i, f in enumerate(frames) if f.parentJoint == link}
            own = {frame: dynamics.placement(i).rotation.T @ normal for frame, i in fixed.items()} | own
        elif isinstance(contact, kinds.PointContact) and not contact.internal:
            own["world"] = contact.axes(dynamics)[:, 2]
        normals[name] = own
    return normals
