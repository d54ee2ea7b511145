"""Builds the safety supervisor from the settings."""

from __future__ import annotations

from wbc_controller.assembly.limits import make_torque_speed
from wbc_controller.core.robot.model import RobotModel
from wbc_controller.safety.supervisor import Supervisor, SupervisorLimits
from wbc_controller.settings import Settings


def make_supervisor(settings: Settings, model: RobotModel) -> Supervisor:
    """Build the safety supervisor."""
    return Supervisor(model, make_supervisor_limits(settings, model))


def make_supervisor_limits(settings: Settings, model: RobotModel) -> SupervisorLimits:
    """Collect the times and limits that the supervisor enforces."""
    safety = settings.safety
    return SupervisorLimits(
        activation_ramp=safety.activation_ramp,
        hold_time=safety.hold_time,
        damping_time=safety.damping_time,
        damping=safety.damping,
        torque_rate=settings.limits.torque_rate,
        period=1.0 / settings.control.rate,
        torque_speed=make_torque_speed(settings, model),
    )
