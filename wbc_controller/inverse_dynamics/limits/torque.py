"""Bounds of the actuator torques: effort limits, torque-speed curve and torque rate limit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wbc_controller.inverse_dynamics.tunable import Tunable
from wbc_controller.records import Array


@dataclass(frozen=True, slots=True)
class TorqueSpeedCurve:
    """Available torque of a motor at a speed.

    τ_max is available up to the corner speed. Above it, the torque falls linearly to 0 at the no-load speed, as the
    voltage above the back-EMF drives the current. This applies in the direction of motion only: when braking, the
    back-EMF helps.
    """

    corner: Array  # corner speed, (na,) in rad/s
    no_load: Array  # no-load speed, above the corner speed, (na,) in rad/s

    def available(self, effort_limits: Array, v: Array) -> tuple[Array, Array]:
        """Return lower and upper bounds of τ, both (na,) in N·m, at speeds v, (na,) in rad/s."""
        left = effort_limits * np.clip((self.no_load - np.abs(v)) / (self.no_load - self.corner), 0.0, 1.0)
        return np.where(v >= 0.0, -effort_limits, -left), np.where(v <= 0.0, effort_limits, left)


class TorqueLimit(Tunable):
    """Limits of available torque, and |τ - τ_before| ≤ rate τ_max Δt if τ_before is given.

    If τ_before is no longer available at a higher joint speed, it is clipped to the available range at once, so both
    limits never conflict.

    Attributes:
        rate: torque rate limit, effort limits per second.
        curve: torque-speed curve; None for τ_max at every speed.
    """

    def __init__(self, effort_limits: Array, rate: float, curve: TorqueSpeedCurve | None = None) -> None:
        self.effort_limits = effort_limits
        self.rate = rate
        self.curve = curve

    def available(self, v: Array) -> tuple[Array, Array]:
        """Return read-only bounds of τ without the rate limit, both (na,) in N·m, at speeds v in rad/s."""
        if self.curve is None:
            return -self.effort_limits, self.effort_limits
        return self.curve.available(self.effort_limits, v)
