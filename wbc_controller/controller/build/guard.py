"""Damping of the guard, without compiled kernels."""

from wbc_controller.estimation.joint_velocity import delay
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array
from wbc_controller.safety.damping import damping_matrix, stable_damping
from wbc_controller.settings import Settings


def velocity_delay(settings: Settings) -> float:
    """Return the delay of the joint velocities, s; 0 if they are measured."""
    known, period = settings.estimation, 1.0 / settings.control.rate
    return delay(known.joint_velocity_time, period) if known.joint_velocity == "differentiated" else 0.0


def make_guard_damping(settings: Settings, model: RobotModel) -> Array:
    """Return K, (na, nj), of the guard's damping torques -K v, for joint states that are up to one period old."""
    D = stable_damping(model, settings.guard.damping, 2.0 / settings.control.rate + velocity_delay(settings))
    return damping_matrix(model.actuation, D)
