"""Model audit from the settings."""

from __future__ import annotations

import numpy as np

from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array
from wbc_controller.safety.model_audit import AuditLimits, ModelAudit
from wbc_controller.settings import Settings


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
