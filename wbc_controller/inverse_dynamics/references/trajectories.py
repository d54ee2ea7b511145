"""Trajectories and ramps of references."""

import bisect
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.robot.orientation import quaternion_of, rotation_of
from wbc_controller.records import Array, Reference, Tuning, frozen

#: Numbers of a tuning besides the gains.
_SCALARS = ("position_margin", "position_horizon", "velocity_scale", "acceleration", "torque_rate")


@dataclass(frozen=True, slots=True)
class Knot:
    """Point of a trajectory."""

    time: float  # s, on the clock of the states
    position: Array  # vector (k,), quaternion (4,), or position and quaternion (7,)
    velocity: Array  # (k,), (3,) or (6,), in world axes
    acceleration: Array  # as the velocity


class Trajectory:
    """Quintics between knots, continuous up to the acceleration; at rest before and after.

    Orientations: rotation vector relative to the start of the segment.
    """

    def __init__(self, knots: Sequence[Knot]) -> None:
        self.knots = tuple(knots)
        size = len(knots[0].velocity)
        # A quaternion adds four values to the position, three to the velocity.
        self._linear = len(knots[0].position) - (4 if len(knots[0].position) != size else 0)
        self._times = [knot.time for knot in knots]
        self._segments: dict[int, Array] = {}  # coefficients of segments, computed at first use
        still = frozen(np.zeros(size))
        # Kept, because tasks cache results by the object.
        self._before, self._after = (Reference(frozen(knots[i].position), still, still) for i in (0, -1))

    def _chart(self, a: Knot, b: Knot) -> list[Array]:
        n = self._linear
        if n == len(a.position):
            return [a.position, a.velocity, a.acceleration, b.position, b.velocity, b.acceleration]
        start, end = rotation_of(a.position[n:]), rotation_of(b.position[n:])
        turn = pin.log3(start.T @ end)
        to_chart = np.linalg.inv(pin.Jexp3(turn))  # body angular velocity to rate of the rotation vector
        rate = to_chart @ end.T @ b.velocity[n:]
        ends = [
            (a.position[:n], np.zeros(3)),
            (a.velocity[:n], start.T @ a.velocity[n:]),
            (a.acceleration[:n], start.T @ a.acceleration[n:]),
            (b.position[:n], turn),
            (b.velocity[:n], rate),
            (b.acceleration[:n], to_chart @ (end.T @ b.acceleration[n:] - _jacobian_dot(turn, rate) @ rate)),
        ]
        return [np.concatenate(parts) for parts in ends]

    def sample(self, time: float) -> Reference:
        """Return the reference at a time in s."""
        knots = self.knots
        if not time >= knots[0].time:
            return self._before
        if time >= knots[-1].time:
            return self._after
        i = bisect.bisect_right(self._times, time) - 1
        coefficients = self._segments.get(i)  # (6, k), by increasing power
        if coefficients is None:
            a, b = knots[i], knots[i + 1]
            coefficients = self._segments[i] = _quintic(self._chart(a, b), b.time - a.time)
        powers = (time - knots[i].time) ** np.arange(6)
        factors = np.arange(1, 6)
        x = powers @ coefficients
        x_dot = (factors * powers[:5]) @ coefficients[1:]
        x_ddot = (factors[1:] * factors[:4] * powers[:4]) @ coefficients[2:]
        n = self._linear
        if n == len(knots[0].position):
            return Reference(x, x_dot, x_ddot)
        return _with_orientation(rotation_of(knots[i].position[n:]), n, x, x_dot, x_ddot)


def _with_orientation(start: Array, n: int, x: Array, x_dot: Array, x_ddot: Array) -> Reference:
    turn, rate = x[n:], x_dot[n:]
    rotation = start @ pin.exp3(turn)
    jacobian = pin.Jexp3(turn)
    angular = rotation @ (jacobian @ rate)
    angular_dot = rotation @ (jacobian @ x_ddot[n:] + _jacobian_dot(turn, rate) @ rate)
    return Reference(
        np.concatenate([x[:n], quaternion_of(rotation)]),
        np.concatenate([x_dot[:n], angular]),
        np.concatenate([x_ddot[:n], angular_dot]),
    )


def _jacobian_dot(turn: Array, rate: Array) -> Array:
    step = 1.0e-5
    return np.asarray((pin.Jexp3(turn + step * rate) - pin.Jexp3(turn - step * rate)) / (2.0 * step))


def _quintic(ends: Sequence[Array], T: float) -> Array:
    """Return the coefficients, (6, k) by increasing power, of the quintic of duration T between given ends."""
    x0, v0, a0, x1, v1, a1 = ends
    d = x1 - x0 - v0 * T - 0.5 * a0 * T**2
    e = (v1 - v0 - a0 * T) * T
    f = (a1 - a0) * T**2
    c3 = (10.0 * d - 4.0 * e + 0.5 * f) / T**3
    c4 = (-15.0 * d + 7.0 * e - f) / T**4
    c5 = (6.0 * d - 3.0 * e + 0.5 * f) / T**5
    return np.stack([x0, v0, 0.5 * a0, c3, c4, c5])


_Ramp = TypeVar("_Ramp", bound="Ramp")


@dataclass(frozen=True, slots=True)
class Ramp:
    """Number that changes linearly between two values."""

    start: float  # s
    duration: float  # s
    before: float  # until the start
    after: float  # from the end on

    def sample(self, time: float) -> float:
        """Return the value at a time in s."""
        if self.duration <= 0.0 or time >= self.start + self.duration:
            return self.after
        share = max(0.0, (time - self.start) / self.duration)
        return self.before + share * (self.after - self.before)

    def towards(self: _Ramp, target: float, time: float, duration: float) -> _Ramp:
        """Return a ramp from the present value to a target."""
        return type(self)(time, duration, self.sample(time), target)


class SoftRamp(Ramp):
    """Ramp of a non-negative number with a linear cube root: no relative jump at zero."""

    __slots__ = ()

    def sample(self, time: float) -> float:
        """Return the value at a time in s."""
        if time >= self.start + self.duration:
            return self.after
        roots = Ramp(self.start, self.duration, float(np.cbrt(self.before)), float(np.cbrt(self.after)))
        return roots.sample(time) ** 3


@dataclass(frozen=True, slots=True)
class TuningRamp:
    """Linear ramp between two tunings.

    Between critically damped tunings, damping is at most 6 % below critical for a stiffness ratio of 4.
    """

    share: Ramp  # share of `after`
    before: Tuning  # until the start
    after: Tuning  # from the end on

    @classmethod
    def at(cls, tuning: Tuning) -> "TuningRamp":
        """Return a constant ramp."""
        return cls(Ramp(0.0, 0.0, 1.0, 1.0), tuning, tuning)

    def sample(self, time: float) -> Tuning:
        """Return the tuning at a time in s; the same object without changes."""
        share = self.share.sample(time)
        return self.after if share >= 1.0 else _between(self.before, self.after, share)

    def towards(self, target: Tuning, time: float, duration: float) -> "TuningRamp":
        """Return a ramp from the present tuning to a target."""
        return TuningRamp(Ramp(time, duration, 0.0, 1.0), self.sample(time), target)


def _between(a: Tuning, b: Tuning, share: float) -> Tuning:
    gains = {
        task: {key: np.asarray(values[key] + share * (b.gains[task][key] - values[key])) for key in values}
        for task, values in a.gains.items()
    }
    return replace(
        b, gains=gains, **{key: getattr(a, key) + share * (getattr(b, key) - getattr(a, key)) for key in _SCALARS}
    )
