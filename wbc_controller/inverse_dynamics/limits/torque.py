"""Bounds of torques."""

from dataclasses import dataclass

import numpy as np

from wbc_controller.inverse_dynamics.tunable import Tunable
from wbc_controller.records import Array


@dataclass(frozen=True, slots=True)
class TorqueSpeedCurve:
    """Available torque of a motor at a speed.

    τ_max is available up to the corner speed and when braking; above, the torque falls linearly to 0 at the no-load
    speed (back-EMF).
    """

    corner: Array  # (na,) in rad/s
    no_load: Array  # (na,) in rad/s, above the corner speed

    def available(self, effort_limits: Array, v: Array) -> tuple[Array, Array]:
        """Return bounds of τ, (na,) in N·m, at speeds v, (na,) in rad/s."""
        left = effort_limits * np.clip((self.no_load - np.abs(v)) / (self.no_load - self.corner), 0.0, 1.0)
        return np.where(v >= 0.0, -effort_limits, -left), np.where(v <= 0.0, effort_limits, left)


class TorqueLimit(Tunable):
    """Limits of available torque, and |τ - τ_before| ≤ rate τ_max Δt if τ_before is given.

    A τ_before that is no longer available is clipped to the available range, so the limits never conflict.
    """

    def __init__(self, effort_limits: Array, rate: float, curve: TorqueSpeedCurve | None = None) -> None:
        self.effort_limits = effort_limits
        self.rate = rate  # effort limits per second
        self.curve = curve  # None for τ_max at every speed

    def available(self, v: Array) -> tuple[Array, Array]:
        """Return read-only bounds of τ, (na,) in N·m, at speeds v in rad/s."""
        if self.curve is None:
            return -self.effort_limits, self.effort_limits
        return self.curve.available(self.effort_limits, v)
