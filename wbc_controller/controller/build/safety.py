"""Times and limits of the safety supervisor; model audit."""

import numpy as np

from wbc_controller.controller.build.estimation import torque_filter, velocity_delay
from wbc_controller.controller.build.limits import make_torque_speed
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array
from wbc_controller.safety.model_audit import AuditLimits, ModelAudit
from wbc_controller.safety.plausibility import FallLimits, PlausibilityLimits
from wbc_controller.safety.supervisor import SupervisorLimits
from wbc_controller.settings import Settings


def make_supervisor_limits(settings: Settings, model: RobotModel) -> SupervisorLimits:
    """Return the times and limits of the supervisor."""
    safety = settings.safety
    return SupervisorLimits(
        activation_ramp=safety.activation_ramp,
        hold_time=safety.hold_time,
        damping_time=safety.damping_time,
        damping=safety.damping,
        torque_rate=settings.limits.torque_rate,
        period=1.0 / settings.control.rate,
        torque_speed=make_torque_speed(settings, model),
        hold_window=safety.hold_window,
        relax_time=safety.relax_time,
        relax_window=safety.relax_window,
        plausibility=make_plausibility(settings),
        velocity_delay=velocity_delay(settings),
        torque_filter=torque_filter(settings),
        fall=FallLimits(tilt=safety.max_tilt, height=safety.min_height),
    )


def make_plausibility(settings: Settings) -> PlausibilityLimits:
    """Return the limits of plausible states."""
    safety = settings.safety
    return PlausibilityLimits(
        magnitude=safety.max_magnitude,
        joint_speed=safety.max_joint_speed,
        base_speed=safety.max_base_speed,
        base_turn=safety.max_base_turn,
        joint_mismatch=safety.joint_mismatch,
        base_mismatch=safety.base_mismatch,
        base_turn_mismatch=safety.base_turn_mismatch,
        frozen_motion=safety.frozen_motion,
        # Odometry may repeat until it is stale.
        frozen_time=max(safety.frozen_time, safety.state_timeout),
    )


def joint_efforts(model: RobotModel) -> Array:
    """Return the largest torque of each joint, (nj,) in N·m; of undriven joints the median."""
    efforts = np.asarray(model.effort_limits @ np.abs(model.actuation.ratios))
    driven = efforts > 0.0
    return np.where(driven, efforts, np.median(efforts[driven]))


def make_audit(settings: Settings, model: RobotModel) -> ModelAudit:
    """Build the model audit."""
    audit = settings.audit
    limits = AuditLimits(
        time_constant=audit.time_constant,
        patience=audit.patience,
        energy=audit.energy,
        power=audit.power,
        force=audit.force * model.mass * model.gravity,
        torques=audit.torque * joint_efforts(model),
        period=1.0 / settings.control.rate,
    )
    return ModelAudit(model, limits)
