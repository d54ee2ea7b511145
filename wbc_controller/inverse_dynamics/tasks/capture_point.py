"""Capture point task."""

import math

import numpy as np

from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.tasks.task import Gains, Mask, RateTask
from wbc_controller.records import Array

_LOWEST_PENDULUM = 0.1  # lower bound of the pendulum height, m, for lying robots


class CapturePointTask(RateTask):
    """Task on the capture point (divergent component of motion), x and y in the world, (2,) in m.

    With the centre of mass c and the height z_s of the support, the capture point of the inverted pendulum,

        ξ = c + ċ / ω,   ω = √(g / (c_z - z_s))                             m, 1/s

    diverges from the centre of pressure, while c converges to ξ: ċ = ω (ξ - c). Control of ξ suffices for balance:

        ξ̇* = ξ̇_ref + k (ξ_ref - ξ)                                          m/s

    With changing height, the rate

        ξ̇ = c̈ / ω + ċ (1 + ċ_z / (2 ω (c_z - z_s)))

    gives the Jacobian J_c / ω and the drift exactly. A weight ω² w here has the effect of the weight w on a task on c̈.

    Sources: Pratt et al., Humanoids 2006; Englsberger, Ott and Albu-Schäffer, T-RO 31, 2015; changing height: Hopkins,
    Hong and Leonessa, Humanoids 2014.
    """

    unit = "m"
    size = 2

    def __init__(
        self, name: str, gravity: float, mask: Mask | None = None, *, support_height: float = 0.0, gain: Gains = 4.0
    ) -> None:
        """Make a task with gravity g in m/s², support height z_s in m and gain k in 1/s."""
        super().__init__(name, [True, True] if mask is None else mask, gain=gain, key="gain")
        self._gravity = gravity
        self.support_height = support_height

    def _height(self, dynamics: Dynamics) -> float:
        return max(float(dynamics.com[2]) - self.support_height, _LOWEST_PENDULUM)

    def omega(self, dynamics: Dynamics) -> float:
        """Return ω, 1/s."""
        return math.sqrt(self._gravity / self._height(dynamics))

    def position(self, dynamics: Dynamics) -> Array:
        """Return ξ, (2,) in m."""
        return np.asarray(dynamics.com[:2] + dynamics.com_velocity[:2] / self.omega(dynamics))

    def jacobian(self, dynamics: Dynamics) -> Array:
        """Return J_c / ω, (2, nv)."""
        return np.asarray(dynamics.com_jacobian[:2] / self.omega(dynamics))

    def drift(self, dynamics: Dynamics) -> Array:
        """Return ξ̇ at v̇ = 0, (2,) in m/s."""
        height, omega, velocity = self._height(dynamics), self.omega(dynamics), dynamics.com_velocity
        rising = velocity[2] / (2.0 * omega * height) if height > _LOWEST_PENDULUM else 0.0
        return np.asarray(dynamics.com_drift[:2] / omega + (1.0 + rising) * velocity[:2])
