"""Residuals of the constraints of a quadratic program."""

from __future__ import annotations

import math

from wbc_controller.compiled import ROWS, VECTOR, VECTOR_OUT, compile_all, compiled, part
from wbc_controller.records import Array


@part
def product(row: Array, x: Array) -> float:
    """A row's product with x, as four sums of every fourth product."""
    n, k = len(x), 0
    s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
    t0, t1, t2, t3 = 0.0, 0.0, 0.0, 0.0
    while k + 8 <= n:
        r, y = row[k : k + 8], x[k : k + 8]
        s0 += r[0] * y[0]
        s1 += r[1] * y[1]
        s2 += r[2] * y[2]
        s3 += r[3] * y[3]
        t0 += r[4] * y[4]
        t1 += r[5] * y[5]
        t2 += r[6] * y[6]
        t3 += r[7] * y[7]
        k += 8
    total = ((s0 + t0) + (s1 + t1)) + ((s2 + t2) + (s3 + t3))
    while k < n:
        total += row[k] * x[k]
        k += 1
    return total


@part
def fill_residuals(
    rows: Array, bounds: Array, offset: Array, value: Array, room: Array, off: Array, outputs: Array
) -> tuple[float, float]:
    """Fill what `residuals` computes; return the smallest room and the largest |A x - b|."""
    m, n = len(off), rows.shape[1] - 1
    x = value[:n]
    most, least = 0.0, math.inf
    for i in range(m):
        off[i] = abs(product(rows[i], x) - rows[i, n])
        if off[i] > most or off[i] != off[i]:
            most = off[i]
    for i in range(m, len(rows)):
        value[n + i - m] = product(rows[i], x)
    for i in range(len(offset)):
        outputs[i] = value[n + i] + offset[i]
    for side in range(2):
        sign = 1.0 - 2.0 * side
        for i in range(len(value)):
            left = sign * (value[i] - bounds[side, i])
            room[side, i] = left
            if left < least or left != left:
                least = left
    return least, most


@part
def violation(least: float, most: float) -> float:
    """The largest violation of a constraint, from the smallest room and the largest |A x - b|; NaN where one is."""
    return math.nan if least != least or most != most else max(0.0, -least, most)


@compiled(ROWS, ROWS, VECTOR, VECTOR_OUT)
def residuals(rows: Array, bounds: Array, offset: Array, found: Array) -> tuple[float, float]:
    """Residuals of constraints A x = b, lower <= [x; C x] <= upper at a point x.

    Args:
        rows: [A, b] and below it [C, 0], (m_eq + m_in, n + 1).
        bounds: lower and upper bounds, (2, n + m_in).
        offset: r of the outputs C x + r of its first rows, (k,).
        found: x, and after it memory for C x; n + m_in others, which stay; then memory for the distances from the lower
            and from the upper bounds, (2, n + m_in), for |A x - b|, (m_eq,), and for the outputs, (k,).

    Returns:
        The smallest room, and the largest violation of a constraint; NaN where a residual is.
    """
    total = bounds.shape[1]
    end = len(found) - len(offset)
    equalities = end - 4 * total
    if not (equalities >= 0 and rows.shape[1] - 1 + len(rows) - equalities == total and bounds.shape[0] == 2):
        raise ValueError("residuals: rows, bounds and found have sizes that do not agree")
    if len(offset) > len(rows) - equalities:
        raise ValueError("residuals: there are more outputs than inequality constraints")
    room, off = found[2 * total : 4 * total].reshape(2, total), found[4 * total : end]
    least, most = fill_residuals(rows, bounds, offset, found[:total], room, off, found[end:])
    return least, violation(least, most)


compile_all()
