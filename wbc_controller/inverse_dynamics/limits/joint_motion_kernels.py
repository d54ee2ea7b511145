"""Bounds of joint accelerations by viability (`limits.joint_motion`, which has the equations)."""

from __future__ import annotations

import math

import numpy as np

from wbc_controller.compiled import TABLE, VECTOR, compile_all, compiled, indices, matrix, part, vector
from wbc_controller.records import Array


@part
def clipped(value: float, lower: float, upper: float) -> float:
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
    bound = clipped(bound, -most, most)
    if late:
        harder = max(_braking(speed, room + stopping), -speed / period)
        if harder < -most:
            return harder
    return bound


@part
def _velocity_bound(speed: float, fastest: float, period: float, ahead: float) -> float:
    """Upper bound of the acceleration from a largest speed; a joint that moves the other way may always stop."""
    return (fastest - speed) / ahead if speed > 0.0 else fastest / ahead - speed / period


@compiled(TABLE, VECTOR, VECTOR)
def acceleration_bounds(table: np.ndarray, q_all: Array, v_all: Array) -> None:
    """Bounds of the joint accelerations from limits of position, velocity and acceleration.

    Args:
        table: the number of joints nj, and 1 where positions are limited, 1 where velocities are; and, in this order,
            q_index: index in q of each joint, (nj,).
            v_index: index in v, and in the bounds, of each joint, (nj,).
            limits: upper position limits of q and of -q, (2, nj) in rad; (2, 0) where there are none.
            fastest: largest speeds, (nj,) in rad/s; (0,) where there are none.
            numbers: largest acceleration, rad/s²; time for which an acceleration is held, s; the same, or a longer
                horizon of the position limits, and of the velocity limits, s; distance beyond its limit within which
                a joint stops that braking with the largest acceleration does not stop, rad; time constant with which
                a joint returns from beyond its limit, s; distance by which rounding may take it there, rad.
            lower: for the lower bounds, by index in v, in rad/s².
            upper: for the upper bounds, likewise.
        q_all: configuration, (nq,) in rad.
        v_all: generalized velocity, (nv,) in rad/s.
    """
    count, limited, slowed = table[0], table[1] > 0, table[2] > 0
    q_index, v_index = indices(table, 3, count), indices(table, 4, count)
    limits, numbers = matrix(table, 5, 2, count if limited else 0), vector(table, 7, 7)
    fastest = vector(table, 6, count if slowed else 0)
    lower, upper = vector(table, 8, len(v_all)), vector(table, 9, len(v_all))
    most, period, ahead, slowing = numbers[0], numbers[1], numbers[2], numbers[3]
    stopping, return_time, rounding = numbers[4], numbers[5], numbers[6]
    for i in range(count):
        column = v_index[i]
        if not (0 <= q_index[i] < len(q_all) and 0 <= column < len(v_all)):
            raise IndexError("the index of a joint is not below the size of q or v")
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
        lower[column] = clipped(clipped(-_velocity_bound(-v, speed, period, slowing), -most, most), low, high)
        upper[column] = clipped(clipped(_velocity_bound(v, speed, period, slowing), -most, most), low, high)


compile_all()
