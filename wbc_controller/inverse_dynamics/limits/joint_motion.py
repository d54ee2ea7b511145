"""Bounds of the joint accelerations that keep positions, velocities and accelerations within limits at all times."""

from __future__ import annotations

import numpy as np

from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.limits.joint_motion_kernels import JointMotion, acceleration_bounds
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.tunable import Tunable
from wbc_controller.records import Array, Tuning

#: Time constant with which a joint beyond its position limit returns, s: slow, as the robot may start there.
RETURN_TIME = 0.1
#: Longest time over which the velocity limits look ahead, s: for torques up to 26 ms late, and well below
#: `RETURN_TIME` / 4, above which a velocity limit would forbid a joint beyond its limit to return.
SLOWING_TIME = 0.017
#: Distance by which rounding may take a joint beyond its limit, rad.
_ROUNDING = 1.0e-11
#: Distance beyond its position limit within which a joint that cannot meet its bounds has to stop, rad.
STOPPING = 0.0165
#: The lower limit of q is treated as an upper limit of -q.
_SIDES = np.array([[1.0], [-1.0]])


class JointMotionLimit(Tunable):
    """Bounds of q̈ that keep every joint in viable states, from which all limits can be met for ever.

    After Del Prete, "Joint position and velocity bounds in discrete-time acceleration/torque control of robot arms"
    (IEEE Robotics and Automation Letters, 2018), in closed form. A state is viable if every joint can stop at its
    limits without reversing, by accelerations of at most q̈_max that are constant over each period T:

        q̇² / (2 q̈_max) + q̇ T / 2 ≤ q_max - q    for q̇ > 0, and mirrored for q̇ < 0.

    The left side is the braking distance; its second term accounts for the last period, at whose end the joint comes to
    rest exactly. Every period has to end in a viable state. With w = q̇ + T q̈ the velocity at the end of the period, and
    d = q_max - q - q̇ T/2 the room that would be left if the joint stopped within it, the condition is

        w² / (2 q̈_max) + w T / 2 ≤ d - w T / 2,    so    q̈ ≤ (√(q̈_max² T² + 2 q̈_max d) - q̈_max T - q̇) / T.

    Velocity limit: q̇ + T q̈ ≤ q̇_max for q̇ > 0, and mirrored for q̇ < 0, with a T of at most `SLOWING_TIME`. Within one
    period it would be a switch, which drives a joint to and fro where torques come late by L; a longer T is a gain of
    1 / T, stable for L < π T / 2. A joint that moves the other way may stop within a period Δt all the same,
    q̈ ≤ q̇_max / T - q̇ / Δt for q̇ < 0: the limit contradicts neither the braking before a position limit nor the return
    from beyond one. Acceleration limit: |q̈| ≤ q̈_max, to which the other two bounds are clipped, but for a joint that
    would run into its stop.

    From a viable state the bounds leave a non-empty interval: full braking, or stopping within the period, meets them
    all. From a state that is not viable a joint brakes with q̈_max, or with what it needs to reverse at its limit (d
    < 0: q̈ ≤ -q̇² / (2 (q_max - q))); where this would take it more than `STOPPING` beyond its limit, with what stops
    it there, up to what stops it within the period. Beyond its position limit a joint returns like a critically
    damped spring with the time constant `RETURN_TIME` / 2. Where position and velocity limits conflict, the position
    limit takes precedence.

    Attributes:
        position_lower: (nj,) in rad, or None where positions are not limited.
        position_upper: (nj,) in rad, or None where positions are not limited.
        velocity: largest speed, (nj,) in rad/s, or None where velocities are not limited.
        acceleration: q̈_max, rad/s².
        horizon: lower bound of T, s. A T longer than the period is viable too, and less sensitive to noise in the
            measured position: near the limit the bound moves by 1 / T² per rad, and by 1 / T per rad/s.
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
        # As upper limits of q and of -q, (2, nj) or, where positions are not limited, (2, 0); and the speeds likewise.
        lower, upper = (np.zeros(0), np.zeros(0)) if position is None else position
        self._limits = np.stack([upper, -lower])
        self._fastest = np.zeros(0) if velocity is None else np.ascontiguousarray(velocity)

    @classmethod
    def of(cls, model: RobotModel, tuning: Tuning, *, position: bool = True, velocity: bool = True) -> JointMotionLimit:
        """Make the limit of a robot from its URDF's limits and the tuning; positions or velocities may be unlimited.

        Raises:
            ConfigurationError: if the margin leaves a joint no room.
        """
        margin = tuning.position_margin
        lower, upper = model.position_lower + margin, model.position_upper - margin
        for name, low, high, unit in zip(model.joints, lower, upper, model.units, strict=True) if position else ():
            if not (low < high):
                raise ConfigurationError(
                    f"limits.position_margin = {margin:g}: it leaves {name!r} no room, whose limits are "
                    f"{low - margin:g} and {high + margin:g} {unit}"
                )
        return cls(
            (lower, upper) if position else None,
            model.velocity_limits * tuning.velocity_scale if velocity else None,
            acceleration=tuning.acceleration,
            horizon=tuning.position_horizon,
        )

    def bounds(self, q: Array, v: Array, period: float) -> tuple[Array, Array]:
        """Lower and upper bounds of the joint accelerations, held for a period in s, both (nj,) in rad/s².

        Joint positions q, (nj,) in rad, and velocities v, (nj,) in rad/s.
        """
        lower, upper, each = np.empty(len(q)), np.empty(len(q)), np.arange(len(q))
        table = self.bind(each, each, period, lower, upper)
        acceleration_bounds(table, np.ascontiguousarray(q), np.ascontiguousarray(v))
        return lower, upper

    def bind(self, q_index: np.ndarray, v_index: np.ndarray, period: float, lower: Array, upper: Array) -> JointMotion:
        """Return the limits and the arrays of their bounds for `acceleration_bounds`.

        Args:
            q_index: index in q of each joint, (nj,).
            v_index: index in v, and in the bounds, of each joint, (nj,).
            period: time for which an acceleration is held, s.
            lower: array of the lower bounds, by index in v, in rad/s²; `upper` likewise.

        Raises:
            ValueError: if the indices have another size than the limits.
        """
        sizes = {len(v_index), self._limits.shape[1] or len(q_index), len(self._fastest) or len(q_index)}
        if sizes != {len(q_index)}:
            raise ValueError(f"{len(q_index)} joints, but their indices in v and their limits are {sorted(sizes)}")
        return JointMotion(
            q_index=q_index,
            v_index=v_index,
            limits=self._limits,
            fastest=self._fastest,
            acceleration=self.acceleration,
            period=period,
            ahead=max(period, self.horizon),
            slowing=max(period, min(self.horizon, SLOWING_TIME)),
            stopping=STOPPING,
            return_time=RETURN_TIME,
            rounding=_ROUNDING,
            lower=lower,
            upper=upper,
        )

    def stopping_bounds(self, q: Array, v: Array, bounds: Array, limits: tuple[Array, Array]) -> Array:
        """Bounds with which a joint still stops, if those of `bounds` cannot be met.

        A joint that moves towards its position limit has to brake, by the same acceleration for all the time, such that
        it stops `STOPPING` beyond that limit: q̈ ≤ -q̇² / (2 (q_max + STOPPING - q)). The others are free.

        Args:
            q: joint positions, (nj,) in rad.
            v: joint velocities, (nj,) in rad/s.
            bounds: lower and upper bounds as in `bounds`, (2, nj) in rad/s².
            limits: lower and upper position limits without the margin, both (nj,) in rad.

        Returns:
            Lower and upper bounds, (2, nj) in rad/s², nowhere tighter than `bounds`; -inf and inf if there is none.
        """
        if self.position_lower is None:
            return np.repeat([[-np.inf], [np.inf]], len(q), axis=1)
        lower, upper = limits
        speed = np.multiply(_SIDES, v)
        room = np.stack([upper + STOPPING - q, q - (lower - STOPPING)])
        held = np.maximum(_braking(speed, room), np.stack([bounds[1], -bounds[0]]))
        above, below = np.where((speed > 0.0) & (held < self.acceleration), held, np.inf)
        return np.stack([-below, above])


def _braking(speed: Array, room: Array) -> Array:
    """The constant acceleration that stops a speed within a room; -inf where there is none."""
    with np.errstate(divide="ignore"):
        return np.where(room > 0.0, -(speed**2) / (2.0 * room), -np.inf)
