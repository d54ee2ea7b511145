"""Kernel for equations of motion and torque bounds."""

from wbc_controller.compilation import Indices, Matrix, OutMatrix, OutVector, Struct, Vector, compiled, part
from wbc_controller.records import Array


class DynamicsRows(Struct):
    """Rows of the equations of motion, below the rows of the contacts."""

    starts: Indices  # of the rows of [N; T] in `columns` and `values`, with end, (free + na + 1,)
    columns: Indices  # of non-zero values of [N; T], (k,)
    values: Vector  # (k,)
    damping: Vector  # D of each row of J, (nf,) in 1/s
    rows: OutMatrix  # [J, 0, required J v̇] of the contacts; from `first` on rows N, then T, (…, nv + nf + 1)
    first: int  # row to fill
    lower: OutVector  # out: bounds of T (M v̇ - Jᵀf), (na,) in N·m
    upper: OutVector  # out
    M: Matrix  # (nv, nv)
    unit: float  # of f, N and N·m
    available: Matrix  # smallest and largest available torques, and τ_max, (3, na) in N·m
    bias: OutVector  # out: T h, (na,) in N·m


@part
def _damp(table: DynamicsRows, v: Array) -> None:
    damping, rows = table.damping, table.rows
    for i in range(len(damping)):
        row, speed = rows[i], 0.0
        for j in range(len(v)):
            speed += row[j] * v[j]
        row[len(row) - 1] -= damping[i] * speed


@part
def _project(table: DynamicsRows, h: Array) -> None:
    """Fill the rows of N and T, and the constants: -N h on the right and T h."""
    M, rows, first, nv, unit, bias = table.M, table.rows, table.first, len(h), table.unit, table.bias
    starts, columns, values, right = table.starts, table.columns, table.values, rows.shape[1] - 1
    free = len(starts) - 1 - len(bias)
    for k in range(len(starts) - 1):
        row, constant = rows[first + k], 0.0
        row[:right] = 0.0
        for place in range(starts[k], starts[k + 1]):
            column, value = columns[place], values[place]
            constant += value * h[column]
            for j in range(nv):
                row[j] += value * M[column, j]
            for i in range(right - nv):
                row[nv + i] -= unit * value * rows[i, column]
        if k < free:
            row[right] = -constant
        else:
            bias[k - free] = constant


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
def fill_dynamics(table: DynamicsRows, h: Vector, v: Vector, before: Vector, share: float) -> None:
    """Fill N (M v̇ - Jᵀf) = -N h and the bounds of τ = T (M v̇ - Jᵀf) + T h; add -D J v to the contact rows.

    `before` is τ_before, (na,); `share` is rate Δt, negative for no torque rate limit.
    """
    if not len(h) == len(v) == len(table.M):
        raise ValueError("fill_dynamics: sizes of h, v and M differ")
    if share >= 0.0 and len(before) != len(table.bias):
        raise ValueError("fill_dynamics: the size of tau_before differs from the number of actuators")
    _damp(table, v)
    _project(table, h)
    _bound(table, before, share)
