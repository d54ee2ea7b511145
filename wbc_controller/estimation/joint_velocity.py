"""Joint velocities from stamped positions.

The g-h filter with fading memory (Brookner, "Tracking and Kalman Filtering Made Easy", 1998, section 1.3),

    x̂⁻ = x̂ + v̂ dt      x̂ = x̂⁻ + (1 - θ²) (x - x̂⁻)      v̂ ← v̂ + (1 - θ)² (x - x̂⁻) / dt      θ = exp(-dt / T),

has the transfer function s / (1 + T s)² at low frequencies, and for a ramp the delay dt (1 + 3θ) / (2 (1 - θ)): 2 T for
short periods, dt / 2 for long ones.
"""

import math

import numpy as np

from wbc_controller.records import Array


def delay(time_constant: float, period: float) -> float:
    """Return the delay of the velocities, s, for the time constant T and the sample period, s."""
    theta = math.exp(-period / time_constant)
    return period * (1.0 + 3.0 * theta) / (2.0 * (1.0 - theta))


class VelocityFilter:
    """Joint velocities from positions; the robot is at rest at the first positions."""

    def __init__(self, time_constant: float) -> None:
        """Start without positions; the time constant T is in s."""
        self._time_constant = time_constant
        self.restart()

    def restart(self) -> None:
        """Reset the filter."""
        self._stamp, self._x, self._v, self._period = 0, np.zeros(0), np.zeros(0), 0.0

    @property
    def delay(self) -> float:
        """Delay of the newest velocities, s; infinite before the second positions."""
        return delay(self._time_constant, self._period) if self._period > 0.0 else math.inf

    def update(self, stamp: int, position: Array) -> Array:
        """Filter positions, (nj,) in rad or m, and return the velocities, (nj,) in rad/s or m/s.

        A repeated stamp, ns, has no effect; an earlier stamp restarts the filter.
        """
        period = 1.0e-9 * (stamp - self._stamp)
        if period == 0.0 and len(self._x):
            return self._v
        if period < 0.0 or not len(self._x):
            self._stamp, self._x, self._v = stamp, np.array(position), np.zeros(len(position))
            return self._v
        theta = math.exp(-period / self._time_constant)
        predicted = self._x + period * self._v
        missed = position - predicted
        self._x = predicted + (1.0 - theta**2) * missed
        self._v = self._v + ((1.0 - theta) ** 2 / period) * missed
        self._stamp, self._period = stamp, period
        return self._v
