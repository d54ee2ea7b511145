"""Times and limits of the safety supervisor."""

from wbc_controller.controller.build.estimation import torque_filter
from wbc_controller.controller.build.guard import velocity_delay
from wbc_controller.controller.build.limits import make_torque_speed
from wbc_controller.inverse_dynamics.robot.model import RobotModel
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
