"""Kernels of `safety.plausibility`."""

import math

import numpy as np

from wbc_controller.compilation import Indices, OutVector, StridedVector, Struct, Vector, compiled, copy, part
from wbc_controller.inverse_dynamics.limits.joint_motion_kernels import clipped
from wbc_controller.inverse_dynamics.robot.placement_kernels import add, cross, dot, put, scale, subtract, three
from wbc_controller.records import Array

MEMORY = 0.2  # time constant T of mismatches, s; averages sensor noise
GAP = 0.05  # largest time between two states for the integration of velocities, s
#: Findings of `compare`, as bits.
OUT_OF_RANGE, JUMPED, STUCK, JOINTS_REPEAT, BASE_REPEATS = 1, 2, 4, 8, 16


class StateMemory(Struct):
    """Limits of states, and the previous state, which kernels update in place."""

    q_index: Indices  # of measured joints, (nj,)
    v_index: Indices  # (nj,)
    base_q: Indices  # (7,), or (0,) with a fixed base
    base_v: Indices  # (6,) or (0,)
    magnitude: float  # largest |q|
    fastest: Vector  # largest |v|, (nv,)
    tolerance: Vector  # largest |x|, (nv,)
    stuck_limit: Vector  # largest |u|, (nv,)
    before: OutVector  # q, (nq,)
    v_before: OutVector  # v, (nv,)
    mismatch: OutVector  # x, (nv,)
    stuck_motion: OutVector  # u, (nv,)


@part
def _repeats(before: Array, now: Array, index: Indices) -> bool:
    """Return True if the values are equal bit for bit."""
    for i in index:
        if before[i] != now[i] or math.copysign(1.0, before[i]) != math.copysign(1.0, now[i]):
            return False
    return True


@part
def _repeats_in_motion(memory: StateMemory, q: Array, v: Array, q_index: Indices, v_index: Indices) -> bool:
    moves = (v[v_index] != 0.0).any()
    return moves and _repeats(memory.before, q, q_index) and _repeats(memory.v_before, v, v_index)


@part
def _is_out_of_range(memory: StateMemory, q: Array, v: Array) -> bool:
    for i in range(len(q)):
        if not abs(q[i]) <= memory.magnitude:
            return True
    for i in range(len(v)):
        if not abs(v[i]) <= memory.fastest[i]:
            return True
    return False


@part
def _base_change(before: Array, q: Array, change: Array) -> None:
    """Write the logarithm of the base's placement relative to the previous one, (6,): Pinocchio's `difference`.

    With the quaternion (ε, η) between them, w = 2 atan2(|ε|, η) ε / |ε|, and p - w × p / 2 + β w × (w × p) with β = (1
    - ϑ/2 cot ϑ/2) / ϑ², ϑ = |w|, and the translation p in the previous axes ((9.26) of Blanco's tutorial on SE(3)).
    """
    a, b = scale(-1.0, three(before, 3)), three(q, 3)  # a: previous rotation, inverted
    epsilon = add(add(scale(before[6], b), scale(q[6], a)), cross(a, b))
    eta = before[6] * q[6] - dot(a, b)
    if eta < 0.0:  # shorter rotation
        epsilon, eta = scale(-1.0, epsilon), -eta
    sine = math.sqrt(dot(epsilon, epsilon))
    half = math.atan2(sine, eta)
    # Angle over the sine of its half; NaN for a zero quaternion.
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
    change, before, first = np.empty(nv), memory.before, len(memory.base_v)
    if first:
        _base_change(before, q, change)
    positions = len(memory.base_q)
    for i in range(len(q) - positions):
        change[first + i] = q[positions + i] - before[positions + i]
    return change


@part
def _update_mismatch(memory: StateMemory, change: Array, v: Array, dt: float, known: bool) -> int:
    """Update x ← (1 - Δt / T) x + Δq - Δt (v₁ + v₂) / 2; after a gap, x is Δq beyond the reach of the speeds."""
    found = 0
    for i in range(len(v)):
        if known:
            integrated = 0.5 * dt * (memory.v_before[i] + v[i])
            memory.mismatch[i] = (1.0 - dt / MEMORY) * memory.mismatch[i] + (change[i] - integrated)
        else:
            reach = abs(dt) * memory.fastest[i]
            memory.mismatch[i] = change[i] - clipped(change[i], -reach, reach)
        if not abs(memory.mismatch[i]) <= memory.tolerance[i]:
            found = JUMPED
    return found


@part
def _update_stuck_motion(memory: StateMemory, change: Array, v: Array, dt: float) -> int:
    """Update u ← (1 - Δt / T) u + Δt (v₁ + v₂) / 2 at constant positions, else 0; return ``STUCK`` beyond the limit."""
    found = 0
    for i in range(len(v)):
        integrated = 0.5 * dt * (memory.v_before[i] + v[i])
        memory.stuck_motion[i] = (1.0 - dt / MEMORY) * memory.stuck_motion[i] + integrated if change[i] == 0.0 else 0.0
        if not abs(memory.stuck_motion[i]) <= memory.stuck_limit[i]:
            found = STUCK
    return found


@compiled
def compare(memory: StateMemory, q: StridedVector, v: StridedVector, dt: float) -> int:
    """Compare a state with the previous one, and store it unless it is out of range.

    The mismatch x is the difference of Δq and Δt (v₁ + v₂) / 2. The stuck motion u is the sum of Δt (v₁ + v₂) / 2 at a
    constant position. Both decay with T; a jump resets u.

    Returns bits: ``OUT_OF_RANGE`` (nothing else is compared); ``JUMPED`` and ``STUCK`` (x and u beyond their limits);
    ``JOINTS_REPEAT`` and ``BASE_REPEATS`` (bit for bit, with non-zero velocities).
    """
    if not (len(q) == len(memory.before) and len(v) == len(memory.v_before)):
        raise ValueError("compare: the sizes of state and memory do not match")
    if _is_out_of_range(memory, q, v):
        return OUT_OF_RANGE
    change, known = _change(memory, q, len(v)), 0.0 <= dt <= GAP
    found = _update_mismatch(memory, change, v, dt, known)
    if found:
        memory.stuck_motion[:] = 0.0
    if not (change[memory.v_index] == 0.0).any():
        memory.stuck_motion[:] = 0.0
    else:
        if known:
            found |= _update_stuck_motion(memory, change, v, dt)
        if _repeats_in_motion(memory, q, v, memory.q_index, memory.v_index):
            found |= JOINTS_REPEAT
    if len(memory.base_q) and _repeats_in_motion(memory, q, v, memory.base_q, memory.base_v):
        found |= BASE_REPEATS
    copy(q, memory.before)
    copy(v, memory.v_before)
    return found


SAMPLE_GAP = 0.1  # largest time between two compared samples, s
VELOCITY_RATE = 20.0  # rate of change of a velocity, in largest velocities per s
#: Findings of `compare_sample`, with the index of a value.
SAMPLE_LARGE, SAMPLE_FAST, SAMPLE_JUMP, SAMPLE_STEP = 0, 1, 2, 3


class SampleMemory(Struct):
    """Limits of the samples of one topic, and the last accepted sample."""

    floating: bool  # True for a base pose, False for joint positions
    measured: bool  # True for measured velocities
    magnitude: float  # largest |position|
    fastest: Vector  # largest |velocity|, (n,)
    velocity_step: Vector  # velocity change by an impact, (n,)
    tolerance: Vector  # of the position change by integrated velocities, (n,)
    position: OutVector  # (n,) or (7,)
    velocity: OutVector  # (n,)
    change: OutVector  # change of position, (n,)


@compiled
def compare_sample(memory: SampleMemory, position: StridedVector, velocity: StridedVector, dt: float) -> int:
    """Compare a sample with its limits and the last accepted one, and store it if it is plausible.

    The position changes by Δt (v₁ + v₂) / 2 within the tolerance, or by at most Δt times the largest velocity if v is
    not measured. A velocity changes by an impact, plus Δt `VELOCITY_RATE` times the largest one. Samples more than
    `SAMPLE_GAP` apart are not compared. Returns -1 for a plausible sample; otherwise 1000 times the finding plus the
    index of the value.
    """
    n = len(memory.fastest)
    sizes = len(velocity) == n or (len(velocity) == 0 and not memory.measured)
    if not (len(position) == len(memory.position) and sizes):
        raise ValueError("compare_sample: the sizes of sample and memory do not match")
    for i in range(len(position)):
        if not abs(position[i]) <= memory.magnitude:
            return 1000 * SAMPLE_LARGE + i
    if memory.measured:
        for i in range(n):
            if not abs(velocity[i]) <= memory.fastest[i]:
                return 1000 * SAMPLE_FAST + i
    if not (0.0 < dt <= SAMPLE_GAP):
        copy(position, memory.position)
        copy(velocity, memory.velocity)
        return -1
    change, last = memory.change, memory.position
    if memory.floating:
        _base_change(last, position, change)
    else:
        for i in range(n):
            change[i] = position[i] - last[i]
    for i in range(n):
        integrated, reach = 0.0, memory.tolerance[i]
        if memory.measured:
            integrated = 0.5 * dt * (memory.velocity[i] + velocity[i])
        else:
            reach += dt * memory.fastest[i]
        if not abs(change[i] - integrated) <= reach:
            return 1000 * SAMPLE_JUMP + i
    if memory.measured:
        for i in range(n):
            step = memory.velocity_step[i] + memory.fastest[i] * VELOCITY_RATE * dt
            if not abs(velocity[i] - memory.velocity[i]) <= step:
                return 1000 * SAMPLE_STEP + i
    copy(position, memory.position)
    copy(velocity, memory.velocity)
    return -1
