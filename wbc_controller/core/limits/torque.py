"""Bounds of the joint torques: size and rate."""

from __future__ import annotations

import numpy as np

from wbc_controller.records import Array


class TorqueLimit:
    """Keeps |τ| ≤ τ_max, and |τ - τ_before| ≤ rate τ_max Δt where there was a torque before.

    Attributes:
        effort_limits: τ_max, (na,) in N·m.
        rate: largest change, in effort limits per second.
    """

    def __init__(self, effort_limits: Array, rate: float) -> None:
        self.effort_limits = effort_limits
        self.rate = rate

    def bounds(self, before: Array | None, period: float) -> tuple[Array, Array]:
        """Lower and upper bounds of τ, both (na,) in N·m.

        Args:
            before: the torques that the joints have now, (na,) in N·m; None where no rate is to be held.
            period: Δt, s.
        """
        limit = self.effort_limits
        if before is None:
            return -limit, limit
        step = self.rate * period * limit
        held = np.clip(before, -limit, limit)
        return np.maximum(-limit, held - step), np.minimum(limit, held + step)
