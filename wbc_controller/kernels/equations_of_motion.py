"""The rows of the equations of motion in the quadratic program, and bounds of the torques."""

from __future__ import annotations

import numpy as np

from wbc_controller.kernels.compiled import (
    ANY_MATRIX,
    ANY_MATRIX_OUT,
    ANY_VECTOR,
    ANY_VECTOR_OUT,
    INDICES,
    INTEGER,
    NUMBER,
    VECTOR,
    VECTOR_OUT,
    compiled,
)
from wbc_controller.records import Array


@compiled(
    INDICES, INDICES, VECTOR, INTEGER, ANY_MATRIX, VECTOR, ANY_MATRIX, ANY_VECTOR, VECTOR, NUMBER,
    ANY_VECTOR_OUT, ANY_MATRIX_OUT, ANY_MATRIX_OUT, ANY_VECTOR_OUT, VECTOR_OUT,
)  # fmt: skip
def fill_rows(
    starts: np.ndarray, columns: np.ndarray, values: Array, free: int, M: Array, h: Array, J: Array, v: Array,
    damping: Array, unit: float, contact_motion: Array, motion: Array, forces: Array, minus_free_bias: Array,
    torque_bias: Array,
) -> None:  # fmt: skip
    """N (M v̇ - Jᵀf) = -N h, and τ = T (M v̇ - Jᵀf) + T h; and the damping of contacts, J v̇ = … - D J v.

    Args:
        starts: begin of each row of [N; T] in `columns` and `values`, and the end of the last, (free + na + 1,).
        columns: where its values are that are not zero.
        values: these values.
        free: number of rows of N.
        M: joint-space inertia matrix, (nv, nv), symmetric.
        h: bias forces, (nv,).
        J: Jacobians of the contacts, (nf, nv).
        v: generalized velocity, (nv,).
        damping: D of each row of J, (nf,) in 1/s.
        unit: of f, N and N·m.
        contact_motion: the required J v̇, to which the damping is added, (nf,).
        motion: for the coefficients of v̇, (free + na, nv).
        forces: for those of f, (free + na, nf).
        minus_free_bias: for -N h, (free,).
        torque_bias: for T h, (na,).
    """
    nv = len(v)
    for i in range(len(J)):
        speed = 0.0
        for j in range(nv):
            speed += J[i, j] * v[j]
        contact_motion[i] -= damping[i] * speed
    for row in range(len(starts) - 1):
        bias = 0.0
        for j in range(nv):
            motion[row, j] = 0.0
        for i in range(len(J)):
            forces[row, i] = 0.0
        for place in range(starts[row], starts[row + 1]):
            column, value = columns[place], values[place]
            bias += value * h[column]
            for j in range(nv):
                motion[row, j] += value * M[j, column]
            for i in range(len(J)):
                forces[row, i] -= unit * value * J[i, column]
        if row < free:
            minus_free_bias[row] = -bias
        else:
            torque_bias[row - free] = bias


@compiled(VECTOR, VECTOR, ANY_VECTOR, VECTOR, NUMBER, VECTOR_OUT, VECTOR_OUT)
def rate_bounds(
    available_lower: Array, available_upper: Array, before: Array, limits: Array, share: float, lower: Array,
    upper: Array,
) -> None:  # fmt: skip
    """Bounds of τ within what is available, and within a share of the limits from what is available of τ_before.

    Args:
        available_lower: (na,) in N·m.
        available_upper: (na,) in N·m.
        before: τ_before, (na,) in N·m.
        limits: τ_max, (na,) in N·m.
        share: rate Δt.
        lower: for the lower bounds, (na,) in N·m; NaN where τ_before is.
        upper: for the upper bounds, (na,) in N·m; likewise.
    """
    for i in range(len(before)):
        held, low, high = before[i], available_lower[i], available_upper[i]
        if held < low:
            held = low
        if held > high:
            held = high
        step = share * limits[i]
        lower[i] = low if low > held - step else held - step
        upper[i] = high if high < held + step else held + step
