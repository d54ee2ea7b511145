"""Centre of mass task."""

import numpy as np

from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.frame_kernels import COM
from wbc_controller.inverse_dynamics.robot.instruction import Instruction
from wbc_controller.inverse_dynamics.tasks.task import MotionTask
from wbc_controller.records import Array


class ComTask(MotionTask):
    """Task on the centre of mass in the world, (3,) in m."""

    unit = "m"
    size = 3

    def instruction(self) -> Instruction | None:
        """Return the instruction."""
        return Instruction(COM, self.rows, size=self.size) if type(self) is ComTask else None

    def position(self, dynamics: Dynamics) -> Array:
        """Return the centre of mass, (3,) in m."""
        return np.array(dynamics.com)

    def velocity(self, dynamics: Dynamics) -> Array:
        """Return its velocity, (3,) in m/s."""
        return dynamics.com_velocity

    def error(self, dynamics: Dynamics, position: Array) -> Array:
        """Return the displacement to the reference, (3,) in m."""
        return position - dynamics.com

    def jacobian(self, dynamics: Dynamics) -> Array:
        """Return its Jacobian, (3, nv)."""
        return dynamics.com_jacobian

    def drift(self, dynamics: Dynamics) -> Array:
        """Return its drift, (3,) in m/s²."""
        return dynamics.com_drift
