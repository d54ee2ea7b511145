"""Kernel of `limits.joint_motion`."""

import math

from wbc_controller.compilation import Indices, Matrix, OutVector, Struct, Vector, compiled, part

RETURN_TIME = 0.1  # time constant beyond a position limit, s: slow, as the robot may start there
STOPPING_DISTANCE = 0.0165  # beyond a position limit, for a joint that cannot meet its bounds, rad
_ROUNDING = 1.0e-11  # of a position limit, rad
_SPRING = 4.0 / RETURN_TIME**2  # 1/s²


class JointMotion(Struct):
    """Limits of joint positions, velocities and accelerations, and the resulting bounds."""

    q_index: Indices  # (nj,)
    v_index: Indices  # also of the bounds, (nj,)
    limits: Matrix  # upper limits of q and -q, (2, nj) in rad, or (2, 0)
    fastest: Vector  # largest speeds, (nj,) in rad/s, or (0,)
    acceleration: float  # rad/s²
    period: float  # s
    ahead: float  # horizon of position limits, s; ≥ `period`
    slowing: float  # horizon of velocity limits, s; ≥ `period`
    lower: OutVector  # out: by index in v, rad/s²
    upper: OutVector  # likewise


@part
def clipped(value: float, lower: float, upper: float) -> float:
    """Clip a value to bounds, to the upper one if they cross; NaN stays NaN."""
    if value < lower:
        value = lower
    return upper if value > upper else value


@part
def _position_bound(table: JointMotion, room: float, speed: float, fastest: float) -> float:
    most, ahead = table.acceleration, table.ahead
    left = room - 0.5 * ahead * speed
    reach = most * ahead
    bound = (math.sqrt(reach**2 + 2.0 * most * max(left, 0.0)) - reach - speed) / ahead
    if left < -_ROUNDING:  # not viable
        bound = _returning_bound(table, room, speed, fastest)
    late = bound < -most
    bound = clipped(bound, -most, most)
    if late:
        harder = max(_braking(speed, room + STOPPING_DISTANCE), -speed / table.period)
        if harder < -most:
            return harder
    return bound


@part
def _returning_bound(table: JointMotion, room: float, speed: float, fastest: float) -> float:
    if not room < _ROUNDING:
        return -(speed**2) / (2.0 * room)
    bound = _SPRING * max(room, -RETURN_TIME * fastest)
    return bound - (speed / table.period if speed > 0.0 else _SPRING * RETURN_TIME * speed)


@part
def _braking(speed: float, room: float) -> float:
    return -(speed**2) / (2.0 * room) if room > 0.0 else -math.inf


@part
def _velocity_bound(table: JointMotion, speed: float, fastest: float) -> float:
    """Return the bound from the velocity limit; a joint moving back may always stop."""
    return (fastest - speed) / table.slowing if speed > 0.0 else fastest / table.slowing - speed / table.period


@compiled
def acceleration_bounds(table: JointMotion, q_all: Vector, v_all: Vector) -> None:
    """Write the bounds of joint accelerations at q (nq,) and v (nv,)."""
    if len(v_all) != len(table.lower) or len(v_all) != len(table.upper):
        raise ValueError("acceleration_bounds: sizes of v and the bounds differ")
    most = table.acceleration
    limited, slowed = table.limits.shape[1] > 0, len(table.fastest) > 0
    for i in range(len(table.q_index)):
        row, column = table.q_index[i], table.v_index[i]
        if not (0 <= row < len(q_all) and 0 <= column < len(v_all)):
            raise IndexError("joint index out of range of q or v")
        q, v = q_all[row], v_all[column]
        if not (math.isfinite(q) and math.isfinite(v)):  # reported by the check for finite values
            table.lower[column] = table.upper[column] = math.nan
            continue
        high, low, fastest = most, -most, table.fastest[i] if slowed else math.inf
        if limited:
            high = _position_bound(table, table.limits[0, i] - q, v, fastest)
            low = -_position_bound(table, table.limits[1, i] + q, -v, fastest)
        if low > high:  # not viable: keep the limit in the direction of motion
            if v > 0.0:
                low = high
            else:
                high = low
        # Position limits precede velocity limits.
        table.lower[column] = clipped(clipped(-_velocity_bound(table, -v, fastest), -most, most), low, high)
        table.upper[column] = clipped(clipped(_velocity_bound(table, v, fastest), -most, most), low, high)
