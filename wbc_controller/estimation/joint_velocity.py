"""Joint velocities from positions and their stamps, for robots whose joint states have none.

The filter is the g-h filter with fading memory (Brookner, "Tracking and Kalman Filtering Made Easy", 1998, section
1.3): it predicts each position with the last velocity, and corrects both by what was measured instead,

    x̂⁻ = x̂ + v̂ dt      x̂ = x̂⁻ + (1 - θ²) (x - x̂⁻)      v̂ ← v̂ + (1 - θ)² (x - x̂⁻) / dt      θ = exp(-dt / T),

where dt is the time between the two stamps, whatever it is. From positions to velocities that is s / (1 + T s)² at low
frequencies. A velocity that changes steadily is told late by dt (1 + 3θ) / (2 (1 - θ)): 2 T for short periods, half a
period for long ones, after which v̂ is the plain difference.
"""

from __future__ import annotations

import math

import numpy as np

from wbc_controller.records import Array


def delay(time_constant: float, period: float) -> float:
    """Delay of the velocities, s, for the time constant T, s."""
    theta = math.exp(-period / time_constant)
    return period * (1.0 + 3.0 * theta) / (2.0 * (1.0 - theta))


class VelocityFilter:
    """Joint velocities from positions; the first positions that it sees are those of a robot at rest."""

    def __init__(self, time_constant: float) -> None:
        """Make a filter that has seen nothing, with the time constant T, s."""
        self._time_constant = time_constant
        self.restart()

    def restart(self) -> None:
        """Forget all: the stamps have begun anew."""
        self._stamp, self._x, self._v = 0, np.zeros(0), np.zeros(0)
        self._period = 0.0

    @property
    def delay(self) -> float:
        """By how much the newest velocities are late, s; infinite before there are two positions."""
        return delay(self._time_constant, self._period) if self._period > 0.0 else math.inf

    def update(self, stamp: int, position: Array) -> Array:
        """Take new positions, (nj,) in rad or m, and return the velocities at them, (nj,) in rad/s or m/s.

        The same stamp, ns, changes nothing, and an earlier one is a new start.
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
