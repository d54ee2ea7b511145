"""Bounds of joint accelerations from joint limits."""

import numpy as np

from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.limits import joint_motion_kernels as kernels
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.tunable import Tunable
from wbc_controller.records import Array, Tuning

#: Longest horizon of velocity limits, s: for torque delays up to 26 ms. Above `RETURN_TIME` / 4, the velocity limit
#: would prevent the return from beyond a position limit.
VELOCITY_HORIZON = 0.017


class JointMotionLimit(Tunable):
    """Bounds of q̈ that keep every joint in viable states, from which all limits can be met for all time.

    After Del Prete, "Joint position and velocity bounds" (IEEE Robotics and Automation Letters, 2018), in closed form.
    A state is viable if the joint can stop at its limits without reversing, with accelerations of at most q̈_max,
    constant over each period T:

        q̇² / (2 q̈_max) + q̇ T / 2 ≤ q_max - q    for q̇ > 0, mirrored for q̇ < 0.

    The left side is the braking distance. Every period has to end in a viable state. With the final velocity w = q̇ + T
    q̈, and the distance d = q_max - q - q̇ T/2 left after a stop within the period,

        w² / (2 q̈_max) + w T / 2 ≤ d - w T / 2,    so    q̈ ≤ (√(q̈_max² T² + 2 q̈_max d) - q̈_max T - q̇) / T.

    Velocity limit: q̇ + T q̈ ≤ q̇_max for q̇ > 0, mirrored for q̇ < 0, with T ≤ `VELOCITY_HORIZON`. T exceeds one
    period because of the torque delay L: the gain 1 / T is stable for L < π T / 2. For q̇ < 0 a joint may always stop
    within a period Δt, q̈ ≤ q̇_max / T - q̇ / Δt, as position limits may require.

    Acceleration limit: |q̈| ≤ q̈_max clips the other bounds. In viable states their interval is not empty. Otherwise a
    joint brakes with q̈_max, or reverses at its limit (d < 0: q̈ ≤ -q̇² / (2 (q_max - q))); a stop beyond
    `STOPPING_DISTANCE` permits harder braking. Beyond its limit it returns like a critically damped spring with the
    time constant `RETURN_TIME` / 2. Position limits precede velocity limits.
    """

    def __init__(
        self, position: tuple[Array, Array] | None, velocity: Array | None, *, acceleration: float, horizon: float = 0.0
    ) -> None:
        self.position = position  # smallest and largest positions, (nj,) in rad, or None
        self.velocity = velocity  # largest speed, (nj,) in rad/s, or None
        self.acceleration = acceleration  # q̈_max, rad/s²
        self.horizon = horizon  # lower bound of T, s; docs/limits.md has its effect on measurement noise
        # Upper limits of q and of -q, (2, nj) or (2, 0); and largest speeds.
        lower, upper = (np.zeros(0), np.zeros(0)) if position is None else position
        self._limits = np.stack([upper, -lower])
        self._fastest = np.zeros(0) if velocity is None else np.ascontiguousarray(velocity)

    @classmethod
    def of(
        cls, model: RobotModel, tuning: Tuning, *, position: bool = True, velocity: bool = True
    ) -> "JointMotionLimit":
        """Make the limit from URDF and tuning; the margin must leave a range for each joint."""
        margin = tuning.position_margin
        lower, upper = model.position_lower + margin, model.position_upper - margin
        for name, low, high, unit in zip(model.joints, lower, upper, model.units, strict=True) if position else ():
            if not (low < high):
                mimics = "" if model.followers is None else ", also of mimic joints"
                raise ConfigurationError(
                    f"limits.position_margin = {margin:g} leaves no range for {name!r}, with the limits "
                    f"{low - margin:g} and {high + margin:g} {unit}{mimics}"
                )
        positions = (lower, upper) if position else None
        velocities = model.velocity_limits * tuning.velocity_scale if velocity else None
        return cls(positions, velocities, acceleration=tuning.acceleration, horizon=tuning.position_horizon)

    def bounds(self, q: Array, v: Array, period: float) -> tuple[Array, Array]:
        """Return bounds of q̈ (nj,) for a period in s, at q and v, (nj,) each."""
        lower, upper, each = np.empty(len(q)), np.empty(len(q)), np.arange(len(q))
        table = self.bind(each, each, period, lower, upper)
        kernels.acceleration_bounds(table, np.ascontiguousarray(q), np.ascontiguousarray(v))
        return lower, upper

    def bind(
        self, q_index: np.ndarray, v_index: np.ndarray, period: float, lower: Array, upper: Array
    ) -> kernels.JointMotion:
        """Return the table for `acceleration_bounds`, with joint indices (nj,) in q, and in v and the bounds."""
        sizes = {len(v_index), self._limits.shape[1] or len(q_index), len(self._fastest) or len(q_index)}
        if sizes != {len(q_index)}:
            raise ValueError(f"expected indices and limits of {len(q_index)} joints, got sizes {sorted(sizes)}")
        return kernels.JointMotion(
            q_index=q_index,
            v_index=v_index,
            limits=self._limits,
            fastest=self._fastest,
            acceleration=self.acceleration,
            period=period,
            ahead=max(period, self.horizon),
            slowing=max(period, min(self.horizon, VELOCITY_HORIZON)),
            lower=lower,
            upper=upper,
        )

    def stopping_bounds(self, q: Array, v: Array, bounds: Array, limits: tuple[Array, Array]) -> Array:
        """Return bounds, not tighter than `bounds` (2, nj), for a stop within `STOPPING_DISTANCE` beyond the limit.

        q̈ ≤ -q̇² / (2 (q_max + STOPPING_DISTANCE - q)); `limits` are without the margin.
        """
        if self.position is None:
            return np.repeat([[-np.inf], [np.inf]], len(q), axis=1)
        (lower, upper), distance = limits, kernels.STOPPING_DISTANCE
        speed, room = np.stack([v, -v]), np.stack([upper + distance - q, q - (lower - distance)])
        with np.errstate(divide="ignore"):
            braking = np.where(room > 0.0, -(speed**2) / (2.0 * room), -np.inf)
        held = np.maximum(braking, np.stack([bounds[1], -bounds[0]]))
        above, below = np.where((speed > 0.0) & (held < self.acceleration), held, np.inf)
        return np.stack([-below, above])
