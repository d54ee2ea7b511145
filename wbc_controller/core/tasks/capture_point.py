"""The capture point: the divergent component of motion, for balance."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from wbc_controller.core.robot.dynamics import Dynamics
from wbc_controller.core.tasks.task import Gains, RateTask
from wbc_controller.records import Array

#: Height of the centre of mass below which ω grows no more: a robot that lies has no pendulum, m.
LOWEST_PENDULUM = 0.1


class CapturePointTask(RateTask):
    """The point on the ground over which the centre of mass would come to rest, x and y in the world, (2,) in m.

    With c the centre of mass and z_s the height of the support, the inverted pendulum's

        ξ = c + ċ / ω,   ω = √(g / (c_z - z_s))                             m, 1/s

    runs away from the centre of pressure at the rate ω, while c follows it by itself: ċ = ω (ξ - c). To hold ξ is to
    balance, and it is all of the motion that must be held. The task asks for

        ξ̇* = ξ̇_ref + k (ξ_ref - ξ)                                          m/s

    which is, for a constant height, the acceleration c̈ = ω (ξ̇* - ċ). With a height that changes the rate is

        ξ̇ = c̈ / ω + ċ (1 + ċ_z / (2 ω (c_z - z_s)))

    and that is what the Jacobian J_c / ω and the drift, here with c̈ at v̇ = 0, are taken from; nothing is neglected. Its
    error in the cost is a velocity, so that ω² times the weight has the effect of the same weight on a task on c̈.

    Sources: Pratt et al., Capture point: a step toward humanoid push recovery, Humanoids 2006; Takenaka et al., Real
    time motion generation and control for biped robot, IROS 2009; Englsberger, Ott and Albu-Schäffer,
    Three-dimensional bipedal walking control based on divergent component of motion, T-RO 31, 2015; for the changing
    height Hopkins, Hong and Leonessa, Humanoid locomotion on uneven terrain using the time-varying divergent component
    of motion, Humanoids 2014.
    """

    size = 2

    def __init__(
        self,
        name: str,
        gravity: float,
        mask: Sequence[bool] | None = None,
        *,
        support_height: float = 0.0,
        gain: Gains = 4.0,
    ) -> None:
        """Make a capture point task.

        Args:
            name: the task's name.
            gravity: g, m/s².
            mask: world axes concerned, x and y; both where it is not given.
            support_height: z_s, m, in the world.
            gain: k, 1/s, one number or one for each axis.

        Raises:
            ConfigurationError: where a list of gains has another length than 2.
        """
        super().__init__(name, [True, True] if mask is None else mask, gain=gain, key="gain")
        self._gravity = gravity
        self.support_height = support_height

    def _height(self, dynamics: Dynamics) -> float:
        return max(float(dynamics.com[2]) - self.support_height, LOWEST_PENDULUM)

    def omega(self, dynamics: Dynamics) -> float:
        """ω, the rate at which the pendulum falls, 1/s."""
        return math.sqrt(self._gravity / self._height(dynamics))

    def position(self, dynamics: Dynamics) -> Array:
        """ξ, (2,) in m."""
        return np.asarray(dynamics.com[:2] + dynamics.com_velocity[:2] / self.omega(dynamics))

    def jacobian(self, dynamics: Dynamics) -> Array:
        """J_c / ω, (2, nv)."""
        return np.asarray(dynamics.com_jacobian[:2] / self.omega(dynamics))

    def drift(self, dynamics: Dynamics) -> Array:
        """ξ̇ at v̇ = 0, (2,) in m/s."""
        height, omega, velocity = self._height(dynamics), self.omega(dynamics), dynamics.com_velocity
        rising = velocity[2] / (2.0 * omega * height) if height > LOWEST_PENDULUM else 0.0
        return np.asarray(dynamics.com_drift[:2] / omega + (1.0 + rising) * velocity[:2])
