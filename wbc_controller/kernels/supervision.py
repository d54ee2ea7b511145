"""What the supervisor computes in every cycle: plausible values and motion, usable torques, and the command."""

from __future__ import annotations

import numpy as np

from wbc_controller.kernels.compiled import (
    ANY_VECTOR,
    INDICES,
    NUMBER,
    VECTOR,
    VECTOR_OUT,
    compiled,
    part,
)
from wbc_controller.records import Array


@compiled(ANY_VECTOR, VECTOR)
def within(values: Array, limits: Array) -> bool:
    """Whether all |values| are at most their limits, (n,) each; not if one is NaN."""
    for i in range(len(values)):
        if not abs(values[i]) <= limits[i]:
            return False
    return True


@compiled(ANY_VECTOR, VECTOR, VECTOR, VECTOR, NUMBER)
def usable(tau: Array, lower: Array, upper: Array, limits: Array, tolerance: float) -> bool:
    """Whether all torques are within bounds but for a share of their limits, (na,) each in N·m; not if one is NaN."""
    for i in range(len(tau)):
        excess = tolerance * limits[i]
        if not (tau[i] >= lower[i] - excess and tau[i] <= upper[i] + excess):
            return False
    return True


@compiled(VECTOR, ANY_VECTOR, ANY_VECTOR, NUMBER, NUMBER, VECTOR_OUT, VECTOR)
def mismatch(
    change: Array, v_before: Array, v: Array, dt: float, keep: float, found: Array, tolerance: Array
) -> tuple[bool, int]:  # fmt: skip
    """The change of a configuration less its integrated velocity, with a memory: x ← keep x + Δq - Δt (v₁ + v₂) / 2.

    Args:
        change: Δq, (nv,).
        v_before: generalized velocity before, (nv,).
        v: generalized velocity, (nv,).
        dt: Δt, s.
        keep: share of x that is kept.
        found: x, (nv,), in place.
        tolerance: largest |x|, (nv,).

    Returns:
        Whether all are within tolerance, and how many components of the change are zero.
    """
    good, still = True, 0
    for i in range(len(change)):
        found[i] = keep * found[i] + (change[i] - 0.5 * dt * (v_before[i] + v[i]))
        good = good and abs(found[i]) <= tolerance[i]
        still += change[i] == 0.0
    return good, still


@part
def _clipped(value: float, lower: float, upper: float) -> float:
    """A value clipped to bounds: upper where they cross, and NaN stays NaN."""
    if value < lower:
        value = lower
    return upper if value > upper else value


@compiled(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR_OUT)
def limited(tau: Array, before: Array, step: Array, lower: Array, upper: Array, out: Array) -> None:
    """Torques within a step of those before, and, last, within what is available, (na,) each in N·m."""
    for i in range(len(tau)):
        out[i] = _clipped(_clipped(tau[i], before[i] - step[i], before[i] + step[i]), lower[i], upper[i])


@compiled(ANY_VECTOR, ANY_VECTOR, VECTOR, INDICES, INDICES, NUMBER, VECTOR_OUT, VECTOR_OUT)
def ahead(
    q: Array, v: Array, v_dot: Array, q_index: np.ndarray, v_index: np.ndarray, period: float, q_out: Array,
    v_out: Array,
) -> None:  # fmt: skip
    """Joint positions and velocities a period ahead, (nj,) each: v + T v̇, and q + T of that."""
    for i in range(len(q_out)):
        v_out[i] = v[v_index[i]] + period * v_dot[v_index[i]]
        q_out[i] = q[q_index[i]] + period * v_out[i]
