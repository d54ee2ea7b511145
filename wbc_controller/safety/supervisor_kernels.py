"""What the supervisor computes in every cycle: how a state follows on the one before, and the command of a solution."""

from __future__ import annotations

import math

import numpy as np

from wbc_controller.compiled import (
    ANY_VECTOR,
    FLAG,
    INDICES,
    NUMBER,
    ROWS,
    TABLE,
    VECTOR,
    VECTOR_OUT,
    compile_all,
    compiled,
    indices,
    matrix,
    part,
    table_at,
    vector,
)
from wbc_controller.inverse_dynamics.limits.joint_motion_kernels import clipped
from wbc_controller.records import Array

#: Time constant with which a mismatch between positions and velocities is forgotten, s: noise of sensors averages out
#: within it, and the lag of a velocity filter adds up over it.
MEMORY = 0.2
#: Time between two states above which what happened between them is not known from their velocities, s.
GAP = 0.05
#: Σ of squares of mismatches, rad² and m², below which none is left.
SETTLED = 1.0e-12
#: What `compared` finds, as a sum; 0 where all values move, or rest, as the velocities say.
ABSURD, JUMPED, STUCK, UNTOLD, JOINTS_REPEAT, BASE_REPEATS = (1 << i for i in range(6))


@part
def _within(values: Array, limits: Array) -> bool:
    for i in range(len(values)):
        if not abs(values[i]) <= limits[i]:
            return False
    return True


@compiled(ANY_VECTOR, VECTOR)
def within(values: Array, limits: Array) -> bool:
    """Whether all |values| are at most their limits, (n,) each; not if one is NaN."""
    if len(values) != len(limits):
        raise ValueError("within: values and limits have different sizes")
    return _within(values, limits)


@part
def _same(a: float, b: float) -> bool:
    """Whether two numbers that are not NaN have the same bits."""
    return a == b and math.copysign(1.0, a) == math.copysign(1.0, b)


@part
def _repeats(before: Array, now: Array, index: np.ndarray) -> bool:
    for i in index:
        if not _same(before[i], now[i]):
            return False
    return True


@part
def _moves(v: Array, index: np.ndarray) -> bool:
    for i in index:
        if v[i] != 0.0:
            return True
    return False


@part
def _cross(a: tuple[float, float, float], b: tuple[float, float, float]) -> tuple[float, float, float]:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@part
def _base_change(before: Array, q: Array, change: Array) -> None:
    """Logarithm of the base's placement relative to the one before, in the first 6 entries: as `pinocchio.difference`.

    With the quaternion (ε, η) between them, the rotation is w = 2 atan2(|ε|, η) ε / |ε|, and of the translation p in
    the axes before the linear part is p - w × p / 2 + β w × (w × p), β = (1 - ϑ/2 cot ϑ/2) / ϑ² with ϑ = |w|: (9.26) of
    Blanco's tutorial on SE(3).
    """
    x0, y0, z0, w0 = -before[3], -before[4], -before[5], before[6]  # the inverse of the rotation before
    x1, y1, z1, w1 = q[3], q[4], q[5], q[6]
    x = w0 * x1 + x0 * w1 + y0 * z1 - z0 * y1
    y = w0 * y1 + y0 * w1 + z0 * x1 - x0 * z1
    z = w0 * z1 + z0 * w1 + x0 * y1 - y0 * x1
    w = w0 * w1 - x0 * x1 - y0 * y1 - z0 * z1
    if w < 0.0:  # the shorter way
        x, y, z, w = -x, -y, -z, -w
    sine = math.sqrt(x * x + y * y + z * z)
    half = math.atan2(sine, w)
    # The angle over the sine of its half; NaN where there is no rotation in the quaternions.
    scale = 2.0 * half / math.sin(half) if sine > 1.0e-8 else 2.0 * w / w
    turn = scale * x, scale * y, scale * z
    squared = turn[0] * turn[0] + turn[1] * turn[1] + turn[2] * turn[2]
    beta = 1.0 / squared - 0.25 * w / (sine * half) if half > 1.0e-4 else 1.0 / 12.0 + squared / 720.0
    axis, moved = (x0, y0, z0), (q[0] - before[0], q[1] - before[1], q[2] - before[2])
    twice = _cross(axis, moved)
    twice = 2.0 * twice[0], 2.0 * twice[1], 2.0 * twice[2]
    across = _cross(axis, twice)
    p = (
        moved[0] + w0 * twice[0] + across[0],
        moved[1] + w0 * twice[1] + across[1],
        moved[2] + w0 * twice[2] + across[2],
    )
    once = _cross(turn, p)
    again = _cross(turn, once)
    for i in range(3):
        change[i] = p[i] - 0.5 * once[i] + beta * again[i]
        change[3 + i] = turn[i]


@part
def _rests(before: Array, v_before: Array, q: Array, v: Array, mismatch: Array) -> bool:
    """Whether nothing moves, by values and by velocities, and no mismatch is left."""
    squares = 0.0
    for i in range(len(v)):
        if v[i] != 0.0 or v_before[i] != 0.0:
            return False
        squares += mismatch[i] * mismatch[i]
    if not squares <= SETTLED:
        return False
    for i in range(len(q)):
        if not _same(before[i], q[i]):
            return False
    return True


@part
def compared(table: np.ndarray, q: Array, v: Array, dt: float, some_untold: bool) -> int:
    """Compare a state with the one before it: what is remembered changes in place, unless the state is absurd or rests.

    With the change of the configuration Δq, and the motion that the velocities tell, d = Δt (v₁ + v₂) / 2, the mismatch
    is x ← (1 - Δt / T) x + Δq - d with T = `MEMORY`, and where a position stays, the motion untold is
    u ← (1 - Δt / T) u + d, else 0. After a `GAP`, where d is not known, x is the part of Δq beyond what the largest
    velocities lead to. A jump empties u.

    Args:
        table: 1 where the base floats, the number of measured joints nj; and, in this order,
            q_index: index in q of each measured joint, (nj,).
            v_index: index in v of each, (nj,).
            limits: largest |v|, |x| and |u|, (3, nv).
            magnitude: largest |q|, (1,).
            before: configuration before, (nq,): of a base that floats in seven coordinates, or of none, and of joints
                with one coordinate each. This one takes its place.
            v_before: generalized velocity before, (nv,), likewise.
            mismatch: x, (nv,), in place.
            untold: u, (nv,), in place.
        q: configuration, (nq,).
        v: generalized velocity, (nv,).
        dt: Δt, s.
        some_untold: whether u is not zero.

    Returns:
        The sum of what was found: whether the state is ``ABSURD``, and no more; x is ``JUMPED`` beyond its tolerance; u
        is ``STUCK`` beyond its own; u is not zero (``UNTOLD``); positions and velocities of the measured joints, or of
        the base, repeat bit for bit, and not all of these velocities are zero (``JOINTS_REPEAT``, ``BASE_REPEATS``).
    """
    floating, limits = table[0] > 0, matrix(table, 4, 3, len(v))
    q_index, v_index = indices(table, 2, table[1]), indices(table, 3, table[1])
    magnitude, before, v_before = vector(table, 5, 1)[0], vector(table, 6, len(q)), vector(table, 7, len(v))
    mismatch, untold = vector(table, 8, len(v)), vector(table, 9, len(v))
    for i in range(len(q)):
        if not abs(q[i]) <= magnitude:
            return ABSURD
    fastest, tolerance, motionless = limits[0], limits[1], limits[2]
    if not _within(v, fastest):
        return ABSURD
    if not some_untold and _rests(before, v_before, q, v, mismatch):
        return 0
    change = np.empty(len(v))
    first, shift = 0, 0
    if floating:
        _base_change(before, q, change)
        first, shift = 6, 1
    for i in range(first, len(v)):
        change[i] = q[i + shift] - before[i + shift]
    known, keep = 0.0 <= dt <= GAP, 1.0 - dt / MEMORY
    found = UNTOLD if some_untold else 0
    jumped = False
    for i in range(len(v)):
        if known:
            mismatch[i] = keep * mismatch[i] + (change[i] - 0.5 * dt * (v_before[i] + v[i]))
        else:
            reach = abs(dt) * fastest[i]
            mismatch[i] = change[i] - clipped(change[i], -reach, reach)
        jumped = jumped or not abs(mismatch[i]) <= tolerance[i]
    if jumped:
        found |= JUMPED
        untold[:] = 0.0
    still = False
    for i in v_index:
        still = still or change[i] == 0.0
    if not still:
        found &= ~UNTOLD
        untold[:] = 0.0
    else:
        if known:
            found |= UNTOLD
            for i in range(len(v)):
                told = 0.5 * dt * (v_before[i] + v[i])
                untold[i] = keep * untold[i] + told if change[i] == 0.0 else 0.0
                if not abs(untold[i]) <= motionless[i]:
                    found |= STUCK
        if _moves(v, v_index) and _repeats(before, q, q_index) and _repeats(v_before, v, v_index):
            found |= JOINTS_REPEAT
    if floating and q[0] == before[0]:
        pose, twist = np.arange(7), np.arange(6)
        if _moves(v, twist) and _repeats(before, q, pose) and _repeats(v_before, v, twist):
            found |= BASE_REPEATS
    for i in range(len(q)):
        before[i] = q[i]
    for i in range(len(v)):
        v_before[i] = v[i]
    return found


@part
def _upward(q: Array) -> tuple[float, float, float]:
    if len(q) < 7:
        raise ValueError("a configuration without a floating base")
    x, y, z, w = q[3], q[4], q[5], q[6]
    return 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)


@compiled(ANY_VECTOR)
def upward(q: Array) -> tuple[float, float, float]:
    """The world's z axis in the axes of a floating base, from a configuration, (nq,)."""
    return _upward(q)


@part
def tilt(q: Array, axis: Array) -> float:
    """Angle between the world's z axis in the axes of a floating base, at a configuration, (nq,), and another, rad."""
    a, b, c = _upward(q)
    return math.acos(clipped(a * axis[0] + b * axis[1] + c * axis[2], -1.0, 1.0))


@compiled(ANY_VECTOR, INDICES, ROWS, ROWS, INDICES, ROWS)
def height(q: Array, parents: np.ndarray, placements: Array, axes: Array, links: np.ndarray, points: Array) -> float:
    """Height of a floating base above the lowest of some points on other links, m; minus infinity where there are none.

    Link 0 is the base's, and link i + 1 that of joint i; each is after the one that carries it. Only the last rows of
    the rotation matrices are needed: the world's z axis in the axes of each link.

    Args:
        q: configuration, (nq,), with one coordinate of each joint.
        parents: link that carries each joint, (n,).
        placements: rotation matrix by rows and translation of each joint on that link, (n, 12).
        axes: motion of each joint, (n, 6): direction in which it slides, or else about which it turns.
        links: links of the points, (k,).
        points: the points on them, (k, 3) in m.
    """
    n = len(parents)
    if not (len(q) >= 7 + n and placements.shape == (n, 12) and axes.shape == (n, 6)):
        raise ValueError("height: q, placements or axes have another size than the joints")
    if points.shape != (len(links), 3):
        raise ValueError("height: there are not three coordinates for each link")
    up, z = np.empty((len(parents) + 1, 3)), np.zeros(len(parents) + 1)
    up[0, 0], up[0, 1], up[0, 2] = _upward(q)
    for i in range(len(parents)):
        a, P, s = up[parents[i]], placements[i], axes[i]
        b = (
            a[0] * P[0] + a[1] * P[3] + a[2] * P[6],
            a[0] * P[1] + a[1] * P[4] + a[2] * P[7],
            a[0] * P[2] + a[1] * P[5] + a[2] * P[8],
        )
        z[i + 1] = z[parents[i]] + a[0] * P[9] + a[1] * P[10] + a[2] * P[11]
        z[i + 1] += q[7 + i] * (b[0] * s[0] + b[1] * s[1] + b[2] * s[2])
        turns = s[3] != 0.0 or s[4] != 0.0 or s[5] != 0.0
        sine, cosine = (math.sin(q[7 + i]), math.cos(q[7 + i])) if turns else (0.0, 1.0)
        along, across = b[0] * s[3] + b[1] * s[4] + b[2] * s[5], _cross(b, (s[3], s[4], s[5]))
        for k in range(3):
            up[i + 1, k] = cosine * b[k] + sine * across[k] + (1.0 - cosine) * along * s[3 + k]
    lowest = np.inf
    for j in range(len(links)):
        a, p = up[links[j]], points[j]
        lowest = min(lowest, z[links[j]] + a[0] * p[0] + a[1] * p[1] + a[2] * p[2])
    return -lowest


@part
def _limited(tau: float, before: float, step: float, lower: float, upper: float) -> float:
    return clipped(clipped(tau, before - step, before + step), lower, upper)


@compiled(VECTOR, VECTOR, VECTOR, NUMBER, VECTOR, VECTOR, VECTOR_OUT)
def limited(tau: Array, before: Array, rate: Array, dt: float, lower: Array, upper: Array, out: Array) -> None:
    """Torques by no more than rate Δt from those before, and, last, within what is available, (na,) each in N·m."""
    n = len(tau)
    if not (len(before) == n and len(rate) == n and len(lower) == n and len(upper) == n and len(out) == n):
        raise ValueError("limited: torques and limits have different sizes")
    for i in range(n):
        out[i] = _limited(tau[i], before[i], dt * rate[i], lower[i], upper[i])


@part
def followed(
    table: np.ndarray, tau: Array, v_dot: Array, q: Array, v: Array, before: Array, share: float, kept: float,
    dt: float, out: Array,
) -> bool:  # fmt: skip
    """The command that follows a solution, if its torques are usable: available but for a tolerance, and not NaN.

    Args:
        table: the number of actuators na and of joints nj; and, in this order,
            limits: effort limits, (na,) in N·m.
            rate: torque rate limit, (na,) in N·m/s.
            q_index: index in q of each joint, (nj,).
            v_index: index in v of each, (nj,).
            available: least and largest torques available, (2, na) in N·m.
            numbers: the share of an effort limit by which a torque may be beyond what is available, as it is clipped;
                and the period T in s, (2,).
        tau: torques of the solution, (na,) in N·m.
        v_dot: its generalized acceleration v̇, (nv,).
        q: configuration, (nq,).
        v: generalized velocity, (nv,).
        before: torques sent before, (na,) in N·m.
        share: share of the solution's torques that is sent.
        kept: share of the torques before in those sent.
        dt: time for which the torque rate limit counts, s.
        out: the torques to be sent, (na,) in N·m, the joint positions a period ahead, q + T of the velocities, (nj,),
            and the velocities then, v + T v̇, (nj,).

    Returns:
        Whether the torques are usable; where they are not, nothing that was written counts.
    """
    na, nj = table[0], table[1]
    limits, rate = vector(table, 2, na), vector(table, 3, na)
    q_index, v_index = indices(table, 4, nj), indices(table, 5, nj)
    available, numbers = matrix(table, 6, 2, na), vector(table, 7, 2)
    if not (len(tau) == na and len(before) == na and len(out) == na + 2 * nj and len(v_dot) == len(v)):
        raise ValueError("followed: torques, accelerations or command have another size than actuators and joints")
    lower, upper, tolerance, period = available[0], available[1], numbers[0], numbers[1]
    for i in range(na):
        excess = tolerance * limits[i]
        if not (tau[i] >= lower[i] - excess and tau[i] <= upper[i] + excess):
            return False
        wanted = share * tau[i]
        if kept != 0.0:
            wanted = kept * before[i] + (1.0 - kept) * wanted
        out[i] = _limited(wanted, before[i], dt * rate[i], lower[i], upper[i])
    for i in range(nj):
        if not (0 <= q_index[i] < len(q) and 0 <= v_index[i] < len(v)):
            raise IndexError("the index of a joint is not below the size of q or v")
        ahead = v[v_index[i]] + period * v_dot[v_index[i]]
        out[na + i] = q[q_index[i]] + period * ahead
        out[na + nj + i] = ahead
    return True


@compiled(
    TABLE, ANY_VECTOR, ANY_VECTOR, NUMBER, FLAG, ANY_VECTOR, ANY_VECTOR, VECTOR, NUMBER, NUMBER, NUMBER, VECTOR_OUT
)
def supervised(
    tables: np.ndarray, q: Array, v: Array, elapsed: float, some_untold: bool, tau: Array, v_dot: Array, before: Array,
    share: float, kept: float, dt: float, out: Array,
) -> tuple[int, float, bool]:  # fmt: skip
    """All that the supervisor computes in a cycle: `compared`, `tilt` and `followed`, which say what the arguments are.

    Args:
        tables: of `compared`, 0 where states are not compared; the axis of `tilt`, (3,), 0 where there is none; and the
            table of `followed`.
        q: configuration, (nq,).
        v: generalized velocity, (nv,).
        elapsed: time since the state before, s; NaN where there is none.
        some_untold: as `compared` has it.
        tau: torques of the solution, (na,) in N·m; (0,) where there is none to be followed.
        v_dot: its generalized acceleration, (nv,).
        before: torques sent before, (na,) in N·m.
        share: share of the solution's torques that is sent.
        kept: share of the torques before in those sent.
        dt: time for which the torque rate limit counts, s.
        out: as `followed` has it.

    Returns:
        What `compared` has found, 0 where it was not called; the tilt in rad, likewise; and whether the torques are
        usable.
    """
    found, tilted, usable = 0, 0.0, False
    if tables[0] != 0 and elapsed == elapsed:
        found = compared(table_at(tables, 0), q, v, elapsed, some_untold)
    if tables[1] != 0:
        tilted = tilt(q, vector(tables, 1, 3))
    if len(tau):
        usable = followed(table_at(tables, 2), tau, v_dot, q, v, before, share, kept, dt, out)
    return found, tilted, usable


compile_all()
