"""Tasks on the centre of mass and the momentum."""

import numpy as np

from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.frame_kernels import COM
from wbc_controller.inverse_dynamics.robot.instruction import Instruction
from wbc_controller.inverse_dynamics.tasks.task import Gains, Mask, MotionTask, RateTask
from wbc_controller.records import Array, Reference


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


class _MomentumTask(RateTask):
    """Task on a part of the centroidal momentum h_G = A_G(q) v, in world axes.

    With ḣ_G = A_G v̇ + Ȧ_G v and the damping D in 1/s, the desired rate is

        ḣ* = ḣ_ref + D (h_ref - h)

    The default reference is 0. There is no stiffness: angular momentum is not integrable, and the centre of mass task
    controls the integral of linear momentum.

    Source: Orin, Goswami and Lee, Autonomous Robots 35, 2013.
    """

    size = 3
    part: slice  # rows of A_G

    def __init__(self, name: str, mask: Mask | None = None, *, damping: Gains = 10.0) -> None:
        super().__init__(name, [True] * 3 if mask is None else mask, gain=damping, key="damping")

    def position(self, dynamics: Dynamics) -> Array:
        return np.asarray(dynamics.centroidal_matrix[self.part] @ dynamics.v)

    def jacobian(self, dynamics: Dynamics) -> Array:
        return np.asarray(dynamics.centroidal_matrix[self.part])

    def drift(self, dynamics: Dynamics) -> Array:
        return np.asarray(dynamics.centroidal_drift[self.part])

    def rest(self, dynamics: Dynamics) -> Reference:
        """Return zero momentum: another one would let the robot drift."""
        still = np.zeros(3)
        return Reference(still, still, still)


class LinearMomentumTask(_MomentumTask):
    """Task on the linear momentum m ċ, (3,) in kg·m/s; its residual is a force, N."""

    unit = "kg·m/s"
    part = slice(0, 3)


class AngularMomentumTask(_MomentumTask):
    """Task on the centroidal angular momentum, (3,) in N·m·s; its residual is a torque, N·m."""

    unit = "N·m·s"
    part = slice(3, 6)
