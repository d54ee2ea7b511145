"""Times and limits of the safety supervisor; model audit."""

import numpy as np

from wbc_controller.controller.build.estimation import torque_filter, velocity_delay
from wbc_controller.controller.build.limits import make_torque_speed
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array
from wbc_controller.safety.model_audit import AuditLimits, ModelAudit
from wbc_controller.safety.supervisor import SupervisorLimits
from wbc_controller.settings import Settings


def make_supervisor_limits(settings: Settings, model: RobotModel) -> SupervisorLimits:
    """Return the times and limits of the supervisor."""
    return SupervisorLimits(
        safety=settings.safety,
        torque_rate=settings.limits.torque_rate,
        period=1.0 / settings.control.rate,
        torque_speed=make_torque_speed(settings, model),
        velocity_delay=velocity_delay(settings),
        torque_filter=torque_filter(settings),
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
        settings=audit,
        force=audit.force * model.mass * model.gravity,
        torques=audit.torque * joint_efforts(model),
        period=1.0 / settings.control.rate,
    )
    return ModelAudit(model, limits)
