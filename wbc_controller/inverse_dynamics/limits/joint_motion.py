"""Bounds of joint accelerations that keep positions, velocities and accelerations within limits."""

from __future__ import annotations

import numpy as np

from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.limits.joint_motion_kernels import JointMotion, acceleration_bounds
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.tunable import Tunable
from wbc_controller.records import Array, Tuning

#: Time constant of the return of a joint beyond its position limit, s: slow, as the robot may start there.
RETURN_TIME = 0.1
#: Longest horizon of the velocity limits, s: for torque delays up to 26 ms, and well below `RETURN_TIME` / 4, above
#: which the velocity limit would prevent the return of a joint beyond its limit.
VELOCITY_HORIZON = 0.017
#: Rounding error of a position beyond its limit, rad.
_ROUNDING = 1.0e-11
#: Distance beyond its position limit within which a joint stops that cannot meet its bounds, rad.
STOPPING_DISTANCE = 0.0165
#: The lower limit of q is an upper limit of -q.
_SIDES = np.array([[1.0], [-1.0]])


class JointMotionLimit(Tunable):
    """Bounds of q̈ that keep every joint in viable states, from which all limits can be met for all time.

    After Del Prete, "Joint position and velocity bounds in discrete-time acceleration/torque control of robot arms"
    (IEEE Robotics and Automation Letters, 2018), in closed form. A state is viable if every joint can stop at its
    limits without reversing, with accelerations of at most q̈_max that are constant over each period T:

        q̇² / (2 q̈_max) + q̇ T / 2 ≤ q_max - q    for q̇ > 0, and mirrored for q̇ < 0.

    The left side is the braking distance, with the discretization of the last period in its second term. Every period
    has to end in a viable state. With the final velocity w = q̇ + T q̈ and d = q_max - q - q̇ T/2, the remaining
    distance after a stop within the period, the condition is

        w² / (2 q̈_max) + w T / 2 ≤ d - w T / 2,    so    q̈ ≤ (√(q̈_max² T² + 2 q̈_max d) - q̈_max T - q̇) / T.

    Velocity limit: q̇ + T q̈ ≤ q̇_max for q̇ > 0, mirrored for q̇ < 0, with T ≤ `VELOCITY_HORIZON`. With T of one
    period, a torque delay L would cause chattering; the gain 1 / T is stable for L < π T / 2. A joint with q̇ < 0 may
    always stop within a period Δt: q̈ ≤ q̇_max / T - q̇ / Δt. The limit therefore never contradicts braking before a
    position limit or the return from beyond it.

    Acceleration limit: |q̈| ≤ q̈_max clips the other bounds, except for a joint that would run into its stop.

    In viable states the bounds leave a non-empty interval that contains full braking or a stop within the period.
    Otherwise a joint brakes with q̈_max, or with the deceleration to reverse at its limit (d < 0: q̈ ≤ -q̇² / (2 (q_max
    - q))). If this exceeded the limit by more than `STOPPING_DISTANCE`, the joint brakes harder, at most to a stop
    within the period. Beyond its limit a joint returns like a critically damped spring with the time constant
    `RETURN_TIME` / 2. Position limits take precedence over velocity limits.

    Attributes:
        position_lower: (nj,) in rad; None for no position limits.
        position_upper: (nj,) in rad; None for no position limits.
        velocity: largest speed, (nj,) in rad/s; None for no velocity limits.
        acceleration: q̈_max, rad/s².
        horizon: lower bound of T, s. A longer T is viable too and less sensitive to measurement noise: near the limit
            the bound changes by 1 / T² per rad, and by 1 / T per rad/s.
    """

    def __init__(
        self, position: tuple[Array, Array] | None, velocity: Array | None, *, acceleration: float, horizon: float = 0.0
    ) -> None:
        """Make a limit; each lower limit is below its upper limit."""
        self.position_lower: Array | None = None
        self.position_upper: Array | None = None
        if position is not None:
            self.position_lower, self.position_upper = position
        self.velocity = velocity
        self.acceleration = acceleration
        self.horizon = horizon
        # Upper limits of q and of -q, (2, nj), or (2, 0) without position limits; and largest speeds.
        lower, upper = (np.zeros(0), np.zeros(0)) if position is None else position
        self._limits = np.stack([upper, -lower])
        self._fastest = np.zeros(0) if velocity is None else np.ascontiguousarray(velocity)

    @classmethod
    def of(cls, model: RobotModel, tuning: Tuning, *, position: bool = True, velocity: bool = True) -> JointMotionLimit:
        """Make the limit of a robot from its URDF and the tuning; positions or velocities may be unlimited.

        Raises:
            ConfigurationError: if the margin leaves no range for a joint.
        """
        margin = tuning.position_margin
        lower, upper = model.position_lower + margin, model.position_upper - margin
        for name, low, high, unit in zip(model.joints, lower, upper, model.units, strict=True) if position else ():
            if not (low < high):
                raise ConfigurationError(
                    f"limits.position_margin = {margin:g} leaves no range for {name!r}, with the limits "
                    f"{low - margin:g} and {high + margin:g} {unit}"
                )
        return cls(
            (lower, upper) if position else None,
            model.velocity_limits * tuning.velocity_scale if velocity else None,
            acceleration=tuning.acceleration,
            horizon=tuning.position_horizon,
        )

    def bounds(self, q: Array, v: Array, period: float) -> tuple[Array, Array]:
        """Return lower and upper bounds of the joint accelerations, both (nj,) in rad/s², constant for a period in s.

        Joint positions q are (nj,) in rad, velocities v (nj,) in rad/s.
        """
        lower, upper, each = np.empty(len(q)), np.empty(len(q)), np.arange(len(q))
        table = self.bind(each, each, period, lower, upper)
        acceleration_bounds(table, np.ascontiguousarray(q), np.ascontiguousarray(v))
        return lower, upper

    def bind(self, q_index: np.ndarray, v_index: np.ndarray, period: float, lower: Array, upper: Array) -> JointMotion:
        """Return limits and arrays of their bounds for `acceleration_bounds`.

        Args:
            q_index: index in q of each joint, (nj,).
            v_index: index in v and in the bounds of each joint, (nj,).
            period: duration of an acceleration, s.
            lower: lower bounds by index in v, rad/s²; `upper` likewise.

        Raises:
            ValueError: for indices and limits of different sizes.
        """
        sizes = {len(v_index), self._limits.shape[1] or len(q_index), len(self._fastest) or len(q_index)}
        if sizes != {len(q_index)}:
            raise ValueError(f"expected indices and limits of {len(q_index)} joints, got sizes {sorted(sizes)}")
        return JointMotion(
            q_index=q_index,
            v_index=v_index,
            limits=self._limits,
            fastest=self._fastest,
            acceleration=self.acceleration,
            period=period,
            ahead=max(period, self.horizon),
            slowing=max(period, min(self.horizon, VELOCITY_HORIZON)),
            stopping=STOPPING_DISTANCE,
            return_time=RETURN_TIME,
            rounding=_ROUNDING,
            lower=lower,
            upper=upper,
        )

    def stopping_bounds(self, q: Array, v: Array, bounds: Array, limits: tuple[Array, Array]) -> Array:
        """Return bounds with which a joint still stops if `bounds` cannot be met.

        A joint that moves towards its position limit must brake with a constant acceleration that stops it within
        `STOPPING_DISTANCE` beyond the limit: q̈ ≤ -q̇² / (2 (q_max + STOPPING_DISTANCE - q)).

        Args:
            q: joint positions, (nj,) in rad.
            v: joint velocities, (nj,) in rad/s.
            bounds: result of `bounds`, (2, nj) in rad/s².
            limits: lower and upper position limits without the margin, both (nj,) in rad.

        Returns:
            Lower and upper bounds, (2, nj) in rad/s², not tighter than `bounds`; infinite for other joints.
        """
        if self.position_lower is None:
            return np.repeat([[-np.inf], [np.inf]], len(q), axis=1)
        lower, upper = limits
        speed = np.multiply(_SIDES, v)
        room = np.stack([upper + STOPPING_DISTANCE - q, q - (lower - STOPPING_DISTANCE)])
        held = np.maximum(_braking(speed, room), np.stack([bounds[1], -bounds[0]]))
        above, below = np.where((speed > 0.0) & (held < self.acceleration), held, np.inf)
        return np.stack([-below, above])


def _braking(speed: Array, room: Array) -> Array:
    """Return the constant acceleration that stops a speed within a distance; -inf without distance."""
    with np.errstate(divide="ignore"):
        return np.where(room > 0.0, -(speed**2) / (2.0 * room), -np.inf)
