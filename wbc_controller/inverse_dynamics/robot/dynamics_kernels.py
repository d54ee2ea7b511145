"""The rows of the equations of motion in the quadratic program, and bounds of the torques."""

from __future__ import annotations

import numpy as np

from wbc_controller.compiled import NUMBER, TABLE, VECTOR, compile_all, compiled, indices, matrix, vector
from wbc_controller.records import Array


@compiled(TABLE, VECTOR, VECTOR, VECTOR, NUMBER)
def fill_dynamics(table: np.ndarray, h: Array, v: Array, before: Array, share: float) -> None:
    """N (M v̇ - Jᵀf) = -N h, and τ = T (M v̇ - Jᵀf) + T h with its bounds; and the damping of contacts, J v̇ = … - D J v.

    The torques are bounded by what is available, and by a share of their limits from what is available of τ_before.

    Args:
        table: the number k of values of [N; T] that are not zero, of rows of N, of rows of T (na), of components of f
            (nf), of all rows, and the first of the rows to be filled, those of N and of T following each other; and, in
            this order,
            starts: begin of each row of [N; T] in `columns` and `values`, and the end of the last, (free + na + 1,).
            columns: where its values are that are not zero, (k,).
            values: these values, (k,).
            damping: D of each row of J, (nf,) in 1/s.
            rows: [J, required J v̇] of the contacts in the first rows, to whose last column the damping is added; the
                coefficients of v̇, those of f and the right-hand sides in the rows to be filled, (…, nv + nf + 1).
            lower: for the lower bounds of T (M v̇ - Jᵀf), (na,) in N·m; NaN where τ_before is.
            upper: for the upper ones, likewise.
            M: joint-space inertia matrix, (nv, nv), symmetric.
            unit: of f, (1,) in N and N·m.
            available: least and largest torques that are available, and τ_max, (3, na) in N·m.
            bias: for T h, (na,) in N·m.
        h: bias forces, (nv,).
        v: generalized velocity, (nv,).
        before: τ_before, (na,) in N·m.
        share: rate Δt; below 0 the change of the torques is not bounded.
    """
    count, free, na, nf, begin, nv = table[0], table[1], table[2], table[3], table[5], len(v)
    right = nv + nf
    starts, columns, values = indices(table, 6, free + na + 1), indices(table, 7, count), vector(table, 8, count)
    damping, rows = vector(table, 9, nf), matrix(table, 10, table[4], right + 1)
    lower, upper, M = vector(table, 11, na), vector(table, 12, na), matrix(table, 13, nv, nv)
    unit, available, bias = vector(table, 14, 1)[0], matrix(table, 15, 3, na), vector(table, 16, na)
    if len(h) != nv:
        raise ValueError("fill_dynamics: h and v have different sizes")
    if share >= 0.0 and len(before) != na:
        raise ValueError("fill_dynamics: the torques before have another size than the actuators")
    for i in range(nf):
        speed = 0.0
        for j in range(nv):
            speed += rows[i, j] * v[j]
        rows[i, right] -= damping[i] * speed
    for k in range(free + na):
        row, constant = rows[begin + k], 0.0
        for j in range(right):
            row[j] = 0.0
        for place in range(starts[k], starts[k + 1]):
            column, value = columns[place], values[place]
            constant += value * h[column]
            for j in range(nv):
                row[j] += value * M[column, j]
            for i in range(nf):
                row[nv + i] -= unit * value * rows[i, column]
        if k < free:
            row[right] = -constant
            continue
        i = k - free
        bias[i] = constant
        low, high = available[0, i], available[1, i]
        if share >= 0.0:
            held, step = before[i], share * available[2, i]
            if held < low:
                held = low
            if held > high:
                held = high
            low = low if low > held - step else held - step
            high = high if high < held + step else held + step
        lower[i], upper[i] = low - constant, high - constant


compile_all()
