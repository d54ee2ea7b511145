"""Bounds of the actuators' torques: size, what the motors have at the present speeds, and rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wbc_controller.core.arrays import clipped
from wbc_controller.records import Array, frozen


@dataclass(frozen=True, slots=True)
class TorqueSpeedCurve:
    """What torque a motor has left at a speed.

    Up to the corner speed it is τ_max, and falls from there along a line to zero at the no-load speed: the voltage left
    over the back-EMF drives the current. That holds in the direction of motion alone. Against it, where the motor
    brakes, the back-EMF helps, and all of τ_max is there.

    Attributes:
        corner: speed up to which τ_max is available, (na,) in rad/s.
        no_load: speed at which no torque is, (na,) in rad/s, above the corner.
    """

    corner: Array
    no_load: Array

    def available(self, effort_limits: Array, v: Array) -> tuple[Array, Array]:
        """Lower and upper bounds of τ at some speeds; both (na,) in N·m.

        Args:
            effort_limits: τ_max, (na,) in N·m.
            v: speeds of the actuators, (na,) in rad/s.
        """
        left = effort_limits * np.clip((self.no_load - np.abs(v)) / (self.no_load - self.corner), 0.0, 1.0)
        return np.where(v >= 0.0, -effort_limits, -left), np.where(v <= 0.0, effort_limits, left)


class TorqueLimit:
    """Keeps τ within what the motors have, and |τ - τ_before| ≤ rate τ_max Δt where there was a torque before.

    Where the torque before is not available any more, as the joint has become faster, it comes within its bounds at
    once: the motor cannot do otherwise, whatever the rate. So the two never contradict each other.

    Attributes:
        rate: largest change, in effort limits per second.
        curve: what is available at which speed; None for τ_max at every speed.
    """

    def __init__(self, effort_limits: Array, rate: float, curve: TorqueSpeedCurve | None = None) -> None:
        self.effort_limits = effort_limits
        self.rate = rate
        self.curve = curve

    @property
    def effort_limits(self) -> Array:
        """τ_max, (na,) in N·m."""
        return self._both[1]

    @effort_limits.setter
    def effort_limits(self, limits: Array) -> None:
        self._both = (frozen(-limits), frozen(limits))

    def available(self, v: Array) -> tuple[Array, Array]:
        """Lower and upper bounds of τ without the rate, both (na,) in N·m; to be read only.

        Args:
            v: speeds of the actuators, (na,) in rad/s.
        """
        return self._both if self.curve is None else self.curve.available(self.effort_limits, v)

    def bounds(self, before: Array | None, v: Array, period: float) -> tuple[Array, Array]:
        """Lower and upper bounds of τ, both (na,) in N·m; to be read only.

        Args:
            before: the torques that the actuators give now, (na,) in N·m; None where no rate is to be held.
            v: speeds of the actuators, (na,) in rad/s.
            period: Δt, s.
        """
        lower, upper = self.available(v)
        if before is None:
            return lower, upper
        step = (self.rate * period) * self.effort_limits
        held = clipped(before, lower, upper)
        return np.maximum(lower, held - step), np.minimum(upper, held + step)
