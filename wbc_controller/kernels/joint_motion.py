"""Bounds of joint accelerations by viability (`limits.joint_motion`, which has the equations)."""

from __future__ import annotations

import math

import numpy as np

from wbc_controller.kernels.compiled import INDICES, NUMBER, ROWS, VECTOR, VECTOR_OUT, compiled, part
from wbc_controller.records import Array


@part
def _clipped(value: float, lower: float, upper: float) -> float:
    """A value clipped to bounds: upper where they cross, and NaN stays NaN."""
    if value < lower:
        value = lower
    return upper if value > upper else value


@part
def _braking(speed: float, room: float) -> float:
    """The constant acceleration that stops a speed within a room; -inf where there is none."""
    return -(speed**2) / (2.0 * room) if room > 0.0 else -math.inf


@part
def _position_bound(
    room: float, speed: float, fastest: float, most: float, period: float, ahead: float, stopping: float,
    return_time: float, rounding: float,
) -> float:  # fmt: skip
    """Upper bound of the acceleration towards a position limit that is `room` away, at a speed towards it."""
    left = room - 0.5 * ahead * speed
    reach = most * ahead
    bound = (math.sqrt(reach**2 + 2.0 * most * max(left, 0.0)) - reach - speed) / ahead
    if left < -rounding:  # not viable
        if room < rounding:  # beyond the limit: back like a spring, at no more than the fastest
            spring = 4.0 / return_time**2
            bound = spring * max(room, -return_time * fastest)
            bound -= speed / period if speed > 0.0 else spring * return_time * speed
        else:  # turns at the limit
            bound = -(speed**2) / (2.0 * room)
    late = bound < -most
    bound = _clipped(bound, -most, most)
    if late:
        harder = max(_braking(speed, room + stopping), -speed / period)
        if harder < -most:
            return harder
    return bound


@part
def _velocity_bound(speed: float, fastest: float, period: float, ahead: float) -> float:
    """Upper bound of the acceleration from a largest speed; a joint that moves the other way may always stop."""
    return (fastest - speed) / ahead if speed > 0.0 else fastest / ahead - speed / period


@compiled(
    INDICES, INDICES, VECTOR, VECTOR, ROWS, VECTOR, NUMBER, NUMBER, NUMBER, NUMBER, NUMBER, NUMBER, NUMBER,
    VECTOR_OUT, VECTOR_OUT,
)  # fmt: skip
def acceleration_bounds(
    q_index: np.ndarray, v_index: np.ndarray, q_all: Array, v_all: Array, limits: Array, fastest: Array, most: float,
    period: float, ahead: float, slowing: float, stopping: float, return_time: float, rounding: float, lower: Array,
    upper: Array,
) -> None:  # fmt: skip
    """Bounds of the joint accelerations from limits of position, velocity and acceleration.

    Args:
        q_index: index in q of each joint, (nj,).
        v_index: index in v, and in the bounds, of each joint, (nj,).
        q_all: configuration, (nq,) in rad.
        v_all: generalized velocity, (nv,) in rad/s.
        limits: upper position limits of q and of -q, (2, nj) in rad; (2, 0) where there are none.
        fastest: largest speeds, (nj,) in rad/s; (0,) where there are none.
        most: largest acceleration, rad/s².
        period: time for which an acceleration is held, s.
        ahead: the same, or a longer horizon of the position limits, s.
        slowing: the same of the velocity limits, s.
        stopping: distance beyond its limit within which a joint stops that braking with `most` does not stop, rad.
        return_time: time constant with which a joint returns from beyond its limit, s.
        rounding: distance by which rounding may take it there, rad.
        lower: for the lower bounds, (nv,) in rad/s².
        upper: for the upper bounds, (nv,) in rad/s².
    """
    limited, slowed = limits.shape[1] > 0, len(fastest) > 0
    for i in range(len(q_index)):
        column = v_index[i]
        q, v = q_all[q_index[i]], v_all[column]
        if not (q * 0.0 == 0.0 and v * 0.0 == 0.0):  # infinite or NaN: seen by the check for finite values
            lower[column] = upper[column] = math.nan
            continue
        high, low, speed = most, -most, fastest[i] if slowed else math.inf
        if limited:
            high = _position_bound(limits[0, i] - q, v, speed, most, period, ahead, stopping, return_time, rounding)
            low = -_position_bound(limits[1, i] + q, -v, speed, most, period, ahead, stopping, return_time, rounding)
        if low > high:  # not viable: keep the limit that the velocity points to
            if v > 0.0:
                low = high
            else:
                high = low
        # Where velocity and position limits conflict, the position limit takes precedence.
        lower[column] = _clipped(_clipped(-_velocity_bound(-v, speed, period, slowing), -most, most), low, high)
        upper[column] = _clipped(_clipped(_velocity_bound(v, speed, period, slowing), -most, most), low, high)
