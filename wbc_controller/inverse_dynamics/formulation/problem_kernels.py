"""Arrays and residuals of a quadratic program."""

import math

import numpy as np

from wbc_controller.compilation import Matrix, OutVector, Struct, Vector, compiled, copy, part
from wbc_controller.records import Array


class Constraints(Struct):
    """Constraints A x = b and lower ≤ [x; C x] ≤ upper, and outputs C x + r of the first rows of C."""

    rows: Matrix  # [A, b] above [C, 0], (m_eq + m_in, n + 1)
    bounds: Matrix  # of [x; C x], (2, n + m_in)
    offset: Vector  # r, (k,)


class LeastSquares(Struct):
    """Cost ½ Σ wᵢ (Rᵢ x - rᵢ)² + ½ Σ dⱼ (xⱼ - tⱼ)² under constraints."""

    rows: Matrix  # [R, r], (k, n + 1)
    weights: Vector  # w, (k,), positive
    base: int  # number of base columns without d and t, determined by as many last equality constraints
    diagonal: Vector  # d, (n,), positive except in the base columns
    target: Vector  # t, (n,)
    constraints: Constraints  # of the problem


@part
def dot(a: Array, b: Array) -> float:
    """Return Σ aₖ bₖ."""
    total = 0.0
    for k in range(len(b)):
        total += a[k] * b[k]
    return total


@compiled
def residuals(constraints: Constraints, found: OutVector) -> tuple[float, float]:
    """Compute the residuals of constraints at x; return the smallest room, or NaN, and the largest |A x - b|.

    `found` is as in `formulation.problem.Residuals`, with x in its first n entries.
    """
    rows, bounds, offset = constraints.rows, constraints.bounds, constraints.offset
    n, total = rows.shape[1] - 1, bounds.shape[1]
    m = len(rows) - (total - n)
    if not (m >= 0 and len(found) == 3 * total + m + len(offset)):
        raise ValueError("residuals: sizes of constraints and results differ")
    if len(offset) > total - n:
        raise ValueError("residuals: more outputs than inequality constraints")
    value, to_lower, to_upper = found[:total], found[total : 2 * total], found[2 * total : 3 * total]
    equalities, outputs = found[3 * total :], found[3 * total + m :]
    largest, least = 0.0, math.inf
    point = np.empty(n + 1)  # [x, -1]
    copy(value[:n], point)
    point[n] = -1.0
    product = np.dot(rows, point)  # [A x - b, C x]
    for i in range(m):
        equalities[i] = abs(product[i])
        if equalities[i] > largest or equalities[i] != equalities[i]:  # keeps NaN
            largest = equalities[i]
    copy(product[m:], value[n:])
    for i in range(len(offset)):
        outputs[i] = product[m + i] + offset[i]
    for i in range(len(value)):
        to_lower[i], to_upper[i] = value[i] - bounds[0, i], bounds[1, i] - value[i]
        for room in (to_lower[i], to_upper[i]):
            if room < least or room != room:  # keeps NaN
                least = room
    return least if largest == largest else math.nan, largest
