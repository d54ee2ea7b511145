"""Bounds of the actuator torques: effort limits, torque-speed curve and torque rate limit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wbc_controller.inverse_dynamics.tunable import Tunable
from wbc_controller.records import Array


@dataclass(frozen=True, slots=True)
class TorqueSpeedCurve:
    """Torque that a motor can give at a speed.

    Up to the corner speed it is τ_max; above, it falls linearly to zero at the no-load speed, because only the voltage
    in excess of the back-EMF drives the current. This applies in the direction of motion only: when the motor brakes,
    the back-EMF helps, and all of τ_max is available.

    Attributes:
        corner: speed up to which τ_max is available, (na,) in rad/s.
        no_load: speed at which no torque is available, (na,) in rad/s, above the corner.
    """

    corner: Array
    no_load: Array

    def available(self, effort_limits: Array, v: Array) -> tuple[Array, Array]:
        """Lower and upper bounds of τ, both (na,) in N·m, at speeds v, (na,) in rad/s; the effort limits are τ_max."""
        left = effort_limits * np.clip((self.no_load - np.abs(v)) / (self.no_load - self.corner), 0.0, 1.0)
        return np.where(v >= 0.0, -effort_limits, -left), np.where(v <= 0.0, effort_limits, left)


class TorqueLimit(Tunable):
    """Keeps τ within the available torque, and |τ - τ_before| ≤ rate τ_max Δt if a torque before is given.

    The torque before may no longer be available, because the joint has become faster. It is then clipped to the
    available range at once, regardless of the rate, as the motor cannot give more. So the two limits never conflict.

    Attributes:
        rate: torque rate limit, in effort limits per second.
        curve: torque-speed curve; None for τ_max at every speed.
    """

    def __init__(self, effort_limits: Array, rate: float, curve: TorqueSpeedCurve | None = None) -> None:
        self.effort_limits = effort_limits
        self.rate = rate
        self.curve = curve

    def available(self, v: Array) -> tuple[Array, Array]:
        """Lower and upper bounds of τ without the rate limit, both (na,) in N·m, for speeds v in rad/s; read-only."""
        if self.curve is None:
            return -self.effort_limits, self.effort_limits
        return self.curve.available(self.effort_limits, v)
