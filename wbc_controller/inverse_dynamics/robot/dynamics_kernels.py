"""Kernel for equations of motion and torque bounds."""

from __future__ import annotations

from wbc_controller.compilation import Indices, Matrix, OutMatrix, OutVector, Struct, Vector, compiled, part
from wbc_controller.records import Array


class DynamicsRows(Struct):
    """Rows of the equations of motion, below the rows of the contacts."""

    starts: Indices  # of the rows of [N; T] in `columns` and `values`, with end, (free + na + 1,)
    columns: Indices  # of non-zero values of [N; T], (k,)
    values: Vector  # (k,)
    rows: OutMatrix  # [J, 0, required J v̇] of the contacts; from `first` on rows N, then T, (…, nv + nf + 1)
    first: int  # row to fill
    lower: OutVector  # out: bounds of T (M v̇ - Jᵀf), (na,) in N·m
    upper: OutVector  # out
    M: Matrix  # (nv, nv)
    unit: float  # of f, N and N·m
    available: Matrix  # smallest and largest available torques, and τ_max, (3, na) in N·m
    bias: OutVector  # out: T h, (na,) in N·m


@part
def _project(table: DynamicsRows, k: int, h: Array) -> float:
    M, rows, row, nv, constant = table.M, table.rows, table.rows[table.first + k], len(h), 0.0
    nf, unit, columns, values = len(row) - 1 - nv, table.unit, table.columns, table.values
    for j in range(nv + nf):
        row[j] = 0.0
    for place in range(table.starts[k], table.starts[k + 1]):
        column, value = columns[place], values[place]
        constant += value * h[column]
        for j in range(nv):
            row[j] += value * M[column, j]
        for i in range(nf):
            row[nv + i] -= unit * value * rows[i, column]
    return constant


@part
def _bound(table: DynamicsRows, before: Array, share: float) -> None:
    least, most, largest, bias = table.available[0], table.available[1], table.available[2], table.bias
    lower, upper = table.lower, table.upper
    for i in range(len(bias)):
        low, high = least[i], most[i]
        if share >= 0.0:
            held, step = before[i], share * largest[i]
            if held < low:
                held = low
            if held > high:
                held = high
            low = low if low > held - step else held - step
            high = high if high < held + step else held + step
        lower[i], upper[i] = low - bias[i], high - bias[i]


@compiled
def fill_dynamics(table: DynamicsRows, h: Vector, before: Vector, share: float) -> None:
    """Fill N (M v̇ - Jᵀf) = -N h and the bounds of τ = T (M v̇ - Jᵀf) + T h.

    `before` is τ_before, (na,); `share` is rate Δt, negative for no torque rate limit.
    """
    na = len(table.bias)
    free, right = len(table.starts) - 1 - na, table.rows.shape[1] - 1
    if len(h) != len(table.M):
        raise ValueError("fill_dynamics: sizes of h and M differ")
    if share >= 0.0 and len(before) != na:
        raise ValueError("fill_dynamics: the size of tau_before differs from the number of actuators")
    for k in range(free + na):
        constant = _project(table, k, h)
        if k < free:
            table.rows[table.first + k, right] = -constant
        else:
            table.bias[k - free] = constant
    _bound(table, before, share)
