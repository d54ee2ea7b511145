"""Linear and angular momentum about the centre of mass."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wbc_controller.core.robot.dynamics import Dynamics
from wbc_controller.core.tasks.task import Gains, RateTask
from wbc_controller.records import Array, Reference


class _MomentumTask(RateTask):
    """A part of the centroidal momentum h_G = A_G(q) v, in the world's axes.

    Its rate is ḣ_G = A_G v̇ + Ȧ_G v, and the task asks for

        ḣ* = ḣ_ref + D (h_ref - h)

    with the damping D in 1/s. A stiffness would act on the integral of the momentum, and the angular momentum is the
    rate of no configuration (it cannot be integrated); for the linear momentum, the task on the centre of mass is that.
    The reference is a momentum; until one is given it is zero.

    Source: Orin, Goswami and Lee, Centroidal dynamics of a humanoid robot, Autonomous Robots 35, 2013.
    """

    size = 3
    #: Rows of A_G that the task takes.
    part: slice

    def __init__(self, name: str, mask: Sequence[bool] | None = None, *, damping: Gains = 10.0) -> None:
        """Make a momentum task.

        Args:
            name: the task's name.
            mask: world axes concerned, (3,); all where it is not given.
            damping: D, 1/s, one number or one for each axis.

        Raises:
            ConfigurationError: where a list of gains has another length than 3.
        """
        super().__init__(name, [True] * 3 if mask is None else mask, gain=damping, key="damping")

    def position(self, dynamics: Dynamics) -> Array:
        """Present momentum, (3,)."""
        return np.asarray(dynamics.centroidal_matrix[self.part] @ dynamics.v)

    def jacobian(self, dynamics: Dynamics) -> Array:
        """Rows of A_G, (3, nv)."""
        return np.asarray(dynamics.centroidal_matrix[self.part])

    def drift(self, dynamics: Dynamics) -> Array:
        """Rate of the momentum at v̇ = 0, (3,)."""
        return np.asarray(dynamics.centroidal_drift[self.part])

    def rest(self, dynamics: Dynamics) -> Reference:
        """Zero momentum: one that is kept would carry the robot away."""
        still = np.zeros(3)
        return Reference(still, still, still)


class LinearMomentumTask(_MomentumTask):
    """Linear momentum m ċ, (3,) in kg·m/s; its error in the cost is a force, N. The law is that of `_MomentumTask`."""

    part = slice(0, 3)


class AngularMomentumTask(_MomentumTask):
    """Angular momentum about the centre of mass, (3,) in N·m·s; its error in the cost is a torque, N·m.

    The law is that of `_MomentumTask`.
    """

    part = slice(3, 6)
