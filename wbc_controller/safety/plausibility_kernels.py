"""Comparison of a state with the one before it: jumps, frozen values and implausible values (`safety.plausibility`)."""

import math

import numpy as np

from wbc_controller.compilation import Indices, OutVector, StridedVector, Struct, Vector, compiled, part
from wbc_controller.inverse_dynamics.limits.joint_motion_kernels import clipped
from wbc_controller.inverse_dynamics.robot.placement_kernels import add, cross, dot, put, scale, subtract, three
from wbc_controller.records import Array

#: Time constant with which a mismatch between positions and velocities is forgotten, s: noise of sensors averages out
#: within it, and the lag of a velocity filter adds up over it.
MEMORY = 0.2
#: Time between two states above which the velocities do not tell the motion between them, s.
GAP = 0.05
#: Σ of squares of mismatches, rad² and m², below which none is left.
SETTLED = 1.0e-12
#: Findings of `compare`, as a sum; 0 if all values move, or rest, as the velocities say.
ABSURD, JUMPED, STUCK, UNTOLD, JOINTS_REPEAT, BASE_REPEATS = 1, 2, 4, 8, 16, 32


class StateMemory(Struct):
    """Limits of states, and what is remembered of the states before.

    Attributes:
        q_index: index in q of each measured joint, (nj,).
        v_index: index in v of each, (nj,).
        base_q: index in q of the base's pose, (7,) or, for a fixed base, (0,).
        base_v: index in v of the base's twist, (6,) or (0,).
        magnitude: largest |q|.
        fastest: largest |v|, (nv,).
        tolerance: largest |x|, (nv,).
        motionless: largest |u|, (nv,).
        before: in place: configuration before, (nq,).
        v_before: in place: generalized velocity before, (nv,).
        mismatch: in place: x, (nv,).
        untold: in place: u, (nv,).
    """

    q_index: Indices
    v_index: Indices
    base_q: Indices
    base_v: Indices
    magnitude: float
    fastest: Vector
    tolerance: Vector
    motionless: Vector
    before: OutVector
    v_before: OutVector
    mismatch: OutVector
    untold: OutVector


@part
def _same(a: float, b: float) -> bool:
    """Return True if two numbers that are not NaN have the same bits."""
    return a == b and math.copysign(1.0, a) == math.copysign(1.0, b)


@part
def _repeats(before: Array, now: Array, index: Indices) -> bool:
    """Return True if some values repeat bit for bit."""
    for i in index:
        if not _same(before[i], now[i]):
            return False
    return True


@part
def _repeats_in_motion(memory: StateMemory, q: Array, v: Array, q_index: Indices, v_index: Indices) -> bool:
    """Return True if some positions and velocities repeat, and not all of these velocities are zero."""
    moves = False
    for i in v_index:
        moves = moves or v[i] != 0.0
    return moves and _repeats(memory.before, q, q_index) and _repeats(memory.v_before, v, v_index)


@part
def _is_absurd(memory: StateMemory, q: Array, v: Array) -> bool:
    """Return True if a value is NaN or beyond its limit."""
    for i in range(len(q)):
        if not abs(q[i]) <= memory.magnitude:
            return True
    for i in range(len(v)):
        if not abs(v[i]) <= memory.fastest[i]:
            return True
    return False


@part
def _rests(memory: StateMemory, q: Array, v: Array) -> bool:
    """Return True if nothing moves, by values and by velocities, and no mismatch is left."""
    squares = 0.0
    for i in range(len(v)):
        if v[i] != 0.0 or memory.v_before[i] != 0.0:
            return False
        squares += memory.mismatch[i] * memory.mismatch[i]
    if not squares <= SETTLED:
        return False
    for i in range(len(q)):
        if not _same(memory.before[i], q[i]):
            return False
    return True


@part
def _base_change(before: Array, q: Array, change: Array) -> None:
    """Write the logarithm of the base's placement relative to the one before, (6,): Pinocchio's `difference`.

    With the quaternion (ε, η) between them, the rotation is w = 2 atan2(|ε|, η) ε / |ε|, and of the translation p in
    the axes before the linear part is p - w × p / 2 + β w × (w × p), β = (1 - ϑ/2 cot ϑ/2) / ϑ² with ϑ = |w|: (9.26) of
    Blanco's tutorial on SE(3).
    """
    a, b = scale(-1.0, three(before, 3)), three(q, 3)  # a: the inverse of the rotation before
    epsilon = add(add(scale(before[6], b), scale(q[6], a)), cross(a, b))
    eta = before[6] * q[6] - dot(a, b)
    if eta < 0.0:  # the shorter way
        epsilon, eta = scale(-1.0, epsilon), -eta
    sine = math.sqrt(dot(epsilon, epsilon))
    half = math.atan2(sine, eta)
    # The angle over the sine of its half; NaN if a quaternion is zero.
    factor = 2.0 * half / math.sin(half) if sine > 1.0e-8 else 2.0 if eta > 0.0 else math.nan
    w = scale(factor, epsilon)
    squared = dot(w, w)
    beta = 1.0 / squared - 0.25 * eta / (sine * half) if half > 1.0e-4 else 1.0 / 12.0 + squared / 720.0
    moved = subtract(three(q, 0), three(before, 0))
    twice = scale(2.0, cross(a, moved))
    p = add(add(moved, scale(before[6], twice)), cross(a, twice))
    once = cross(w, p)
    put(change, 0, add(subtract(p, scale(0.5, once)), scale(beta, cross(w, once))))
    put(change, 3, w)


@part
def _change(memory: StateMemory, q: Array, nv: int) -> Array:
    """Return the change of the configuration since the state before, (nv,)."""
    change, first = np.empty(nv), len(memory.base_v)
    if first:
        _base_change(memory.before, q, change)
    for i in range(first, nv):
        row = i + len(memory.base_q) - first
        change[i] = q[row] - memory.before[row]
    return change


@part
def _update_mismatch(memory: StateMemory, change: Array, v: Array, dt: float, known: bool) -> int:
    """Update x ← (1 - Δt / T) x + Δq - Δt (v₁ + v₂) / 2; return ``JUMPED`` if it is beyond its tolerance.

    If the motion in between is not known, x is the part of Δq beyond the reach of the largest velocities.
    """
    found = 0
    for i in range(len(v)):
        if known:
            told = 0.5 * dt * (memory.v_before[i] + v[i])
            memory.mismatch[i] = (1.0 - dt / MEMORY) * memory.mismatch[i] + (change[i] - told)
        else:
            reach = abs(dt) * memory.fastest[i]
            memory.mismatch[i] = change[i] - clipped(change[i], -reach, reach)
        if not abs(memory.mismatch[i]) <= memory.tolerance[i]:
            found = JUMPED
    return found


@part
def _update_untold(memory: StateMemory, change: Array, v: Array, dt: float) -> int:
    """Update u ← (1 - Δt / T) u + Δt (v₁ + v₂) / 2 while a position stays, else 0; return ``STUCK`` beyond a limit."""
    found = 0
    for i in range(len(v)):
        told = 0.5 * dt * (memory.v_before[i] + v[i])
        memory.untold[i] = (1.0 - dt / MEMORY) * memory.untold[i] + told if change[i] == 0.0 else 0.0
        if not abs(memory.untold[i]) <= memory.motionless[i]:
            found = STUCK
    return found


@compiled
def compare(memory: StateMemory, q: StridedVector, v: StridedVector, dt: float, some_untold: bool) -> int:
    """Compare a state with the one before it, which it replaces in the memory unless it is absurd or rests.

    The velocities tell the motion Δt (v₁ + v₂) / 2. The mismatch x is its difference from the change of the
    configuration Δq, the motion untold u its sum while a position stays; both are forgotten with T = `MEMORY`. A jump
    resets u.

    Args:
        dt: Δt, s.
        some_untold: True if u is not zero.

    Returns:
        The sum of the findings: the state is ``ABSURD``, and nothing else is compared; x is ``JUMPED`` beyond its
        tolerance; u is ``STUCK`` beyond its own; u is not zero (``UNTOLD``); positions and velocities of the measured
        joints, or of the base, repeat bit for bit, and not all of these velocities are zero (``JOINTS_REPEAT``,
        ``BASE_REPEATS``).
    """
    if not (len(q) == len(memory.before) and len(v) == len(memory.v_before)):
        raise ValueError("compare: the state has another size than the memory")
    if _is_absurd(memory, q, v):
        return ABSURD
    if not some_untold and _rests(memory, q, v):
        return 0
    change, known = _change(memory, q, len(v)), 0.0 <= dt <= GAP
    found = _update_mismatch(memory, change, v, dt, known)
    if found:
        memory.untold[:] = 0.0
    still = False
    for i in memory.v_index:
        still = still or change[i] == 0.0
    if not still:
        memory.untold[:] = 0.0
    else:
        if known:
            found |= UNTOLD | _update_untold(memory, change, v, dt)
        elif some_untold:
            found |= UNTOLD
        if _repeats_in_motion(memory, q, v, memory.q_index, memory.v_index):
            found |= JOINTS_REPEAT
    if len(memory.base_q) and _repeats_in_motion(memory, q, v, memory.base_q, memory.base_v):
        found |= BASE_REPEATS
    for i in range(len(q)):
        memory.before[i] = q[i]
    for i in range(len(v)):
        memory.v_before[i] = v[i]
    return found


#: Time between two samples above which they are not compared, s.
SAMPLE_GAP = 0.1
#: Rate of change of a velocity, as a multiple of the largest velocity per s.
VELOCITY_RATE = 20.0
#: Findings of `compare_sample`, each with the index of a value.
SAMPLE_LARGE, SAMPLE_FAST, SAMPLE_JUMP, SAMPLE_KICK = 0, 1, 2, 3


class SampleMemory(Struct):
    """Limits of the samples of one message type, and the last accepted sample.

    Attributes:
        floating: True if the position is the base's pose, (7,), False if it contains joint positions.
        measured: True if velocities are measured.
        magnitude: largest |position|.
        fastest: largest |velocity|, (n,).
        kick: change of a velocity by an impact, (n,).
        tolerance: largest difference between a change of the position and the velocities, integrated, (n,).
        position: in place: position of the last accepted sample, (n,) or (7,).
        velocity: in place: its velocity, (n,).
        change: in place: change of the position from the last accepted sample, (n,).
    """

    floating: bool
    measured: bool
    magnitude: float
    fastest: Vector
    kick: Vector
    tolerance: Vector
    position: OutVector
    velocity: OutVector
    change: OutVector


@part
def _keep_sample(memory: SampleMemory, position: Array, velocity: Array) -> None:
    """Compare the next sample with this one."""
    for i in range(len(position)):
        memory.position[i] = position[i]
    for i in range(len(velocity)):
        memory.velocity[i] = velocity[i]


@compiled
def compare_sample(memory: SampleMemory, position: StridedVector, velocity: StridedVector, dt: float) -> int:
    """Compare a sample with its limits and with the last accepted one, which it replaces if it is plausible.

    The change of the position is Δt (v₁ + v₂) / 2 up to a tolerance; without measured velocities it is within
    Δt times the largest velocity. A velocity changes by an impact, and by Δt `VELOCITY_RATE` of the largest one.

    Args:
        dt: Δt, s; the samples are compared if it is positive and up to `SAMPLE_GAP`.

    Returns:
        -1 if the sample is plausible; otherwise the kind of the finding times 1000, plus the index of the value.
    """
    n = len(memory.fastest)
    if not (len(position) == len(memory.position) and (len(velocity) == n or not memory.measured)):
        raise ValueError("compare_sample: the sample has another size than the memory")
    for i in range(len(position)):
        if not abs(position[i]) <= memory.magnitude:
            return 1000 * SAMPLE_LARGE + i
    if memory.measured:
        for i in range(n):
            if not abs(velocity[i]) <= memory.fastest[i]:
                return 1000 * SAMPLE_FAST + i
    if not (0.0 < dt <= SAMPLE_GAP):
        _keep_sample(memory, position, velocity)
        return -1
    if memory.floating:
        _base_change(memory.position, position, memory.change)
    else:
        for i in range(n):
            memory.change[i] = position[i] - memory.position[i]
    for i in range(n):
        told, reach = 0.0, memory.tolerance[i]
        if memory.measured:
            told = 0.5 * dt * (memory.velocity[i] + velocity[i])
        else:
            reach += dt * memory.fastest[i]
        if not abs(memory.change[i] - told) <= reach:
            return 1000 * SAMPLE_JUMP + i
    if memory.measured:
        for i in range(n):
            step = memory.kick[i] + memory.fastest[i] * VELOCITY_RATE * dt
            if not abs(velocity[i] - memory.velocity[i]) <= step:
                return 1000 * SAMPLE_KICK + i
    _keep_sample(memory, position, velocity)
    return -1
