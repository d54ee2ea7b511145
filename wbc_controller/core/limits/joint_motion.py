"""Bounds of the joint accelerations that keep joint positions and velocities within theirs."""

from __future__ import annotations

import numpy as np

from wbc_controller.records import Array


class JointMotionLimit:
    """Keeps joints within position and velocity limits by bounds on their accelerations.

    Position: q̈ ≤ 4/T² (q_max - q - T q̇), with the horizon T. It brakes once the joint would reach its limit within T,
    and being critically damped (s = q̇ - 2/T (q_max - q) obeys ṡ ≤ -2/T s, so it stays negative) it comes to rest at
    the limit without crossing it. Velocity: after one period, q̇ + Δt q̈ ≤ q̇_max. Neither ever asks for more than the
    largest acceleration; where they disagree, position goes first.

    Attributes:
        position_lower: (na,) in rad, or None where positions are not limited.
        position_upper: (na,) in rad, or None.
        velocity: largest speed, (na,) in rad/s, or None where velocities are not limited.
        horizon: T, s.
        acceleration: largest acceleration that a limit may ask for, rad/s².
    """

    def __init__(
        self,
        position: tuple[Array, Array] | None,
        velocity: Array | None,
        *,
        horizon: float,
        acceleration: float,
    ) -> None:
        self.position_lower: Array | None = None
        self.position_upper: Array | None = None
        if position is not None:
            self.position_lower, self.position_upper = position
        self.velocity = velocity
        self.horizon = horizon
        self.acceleration = acceleration

    def bounds(self, q: Array, v: Array, period: float) -> tuple[Array, Array]:
        """Lower and upper bounds of the joint accelerations, both (na,) in rad/s².

        Args:
            q: joint positions, (na,) in rad.
            v: joint velocities, (na,) in rad/s.
            period: Δt, s.
        """
        most = self.acceleration
        lower = np.full(len(q), -most)
        upper = np.full(len(q), most)
        if self.velocity is not None:
            np.clip((-self.velocity - v) / period, -most, most, out=lower)
            np.clip((self.velocity - v) / period, -most, most, out=upper)
        if self.position_lower is not None and self.position_upper is not None:
            horizon = max(self.horizon, 2.0 * period)  # with a shorter one the sampled law would overshoot
            scale = 4.0 / horizon**2
            ahead = q + horizon * v
            position_lower = np.clip(scale * (self.position_lower - ahead), -most, most)
            position_upper = np.clip(scale * (self.position_upper - ahead), -most, most)
            # Intersect, and let the position have its way where the two intervals do not meet.
            lower = np.clip(lower, position_lower, position_upper)
            upper = np.clip(upper, position_lower, position_upper)
        return lower, upper
