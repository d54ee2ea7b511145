"""Ideal IMU."""

from collections import deque
from typing import Any

import pinocchio as pin

from wbc_controller.inverse_dynamics.robot.orientation import quaternion_of
from wbc_controller.records import Array
from wbc_controller.simulation.body_frame import BodyFrame


class Imu:
    """IMU without errors in a frame, in a simulation with `steps` of `step_seconds` per control period."""

    def __init__(self, frame: BodyFrame, model: Any, data: Any, steps: int, step_seconds: float) -> None:
        self._frame, self._model, self._data, self._step = frame, model, data, step_seconds
        self._velocities: deque[Array] = deque(maxlen=steps + 1)  # in the world after each step of a period, m/s

    def restart(self) -> None:
        """Forget the earlier velocities; the next measurement is a first one."""
        self._velocities.clear()

    def advance(self) -> None:
        """Store the velocity after a step, if it measured before."""
        if self._velocities:
            self._velocities.append(self._frame.motion(self._model, self._data)[1])

    def measure(self) -> tuple[Array, Array, Array]:
        """Return orientation (x, y, z, w), angular velocity in rad/s, and specific force in m/s².

        The force is the mean of the last control period; of a first measurement, the present value.
        """
        rotation = self._frame.in_world(self._data).rotation
        turning, velocity = self._frame.motion(self._model, self._data)
        if not self._velocities:
            self._velocities.append(velocity)
        steps = len(self._velocities) - 1
        if steps:
            duration = steps * self._step
            middle = pin.exp3(0.5 * duration * turning)  # half a period
            change = self._velocities[-1] - self._velocities[0]
            force = middle @ (change / duration - self._model.opt.gravity)
        else:
            force = self._frame.specific_force(self._model, self._data)
        return quaternion_of(rotation), rotation.T @ turning, rotation.T @ force
