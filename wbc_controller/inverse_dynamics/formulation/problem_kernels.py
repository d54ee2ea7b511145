"""Arrays of a quadratic program for kernels, and residuals of its constraints at a point."""

import math

import numpy as np

from wbc_controller.compilation import Matrix, OutMatrix, OutVector, Struct, Vector, compiled, part
from wbc_controller.records import Array


class Constraints(Struct):
    """Constraints A x = b and lower ≤ [x; C x] ≤ upper, and outputs C x + r of the first rows of C.

    Attributes:
        rows: [A, b] above [C, 0], (m_eq + m_in, n + 1).
        bounds: lower and upper bounds of x, then of C x, (2, n + m_in).
        offset: r, (k,).
    """

    rows: Matrix
    bounds: Matrix
    offset: Vector


class LeastSquares(Struct):
    """The cost ½ Σ wᵢ (Rᵢ x - rᵢ)² + ½ Σ dⱼ (xⱼ - tⱼ)² under constraints.

    Attributes:
        rows: [R, r], (k, n + 1).
        weights: w, (k,), positive.
        base: number of leading columns without d and t (those of a floating base). As many of the last equality
            constraints determine these variables: that block is invertible.
        diagonal: d, (n,), positive except in the leading columns.
        target: t, (n,).
        constraints: of the quadratic program.
    """

    rows: Matrix
    weights: Vector
    base: int
    diagonal: Vector
    target: Vector
    constraints: Constraints


@part
def dot(a: Array, b: Array) -> float:
    """Return Σ aₖ bₖ."""
    total = 0.0
    for k in range(len(b)):
        total += a[k] * b[k]
    return total


@compiled
def residuals(
    constraints: Constraints, value: OutVector, room: OutMatrix, equalities: OutVector, outputs: OutVector
) -> tuple[float, float]:
    """Compute the residuals of constraints at a point x.

    Args:
        value: x, followed by memory for C x, (n + m_in,).
        room: for the distances of x and C x from their lower and upper bounds, (2, n + m_in).
        equalities: for |A x - b|, (m_eq,).
        outputs: for C x + r, (k,).

    Returns:
        The smallest room, and the largest |A x - b|; NaN if one is NaN.
    """
    rows, bounds, offset = constraints.rows, constraints.bounds, constraints.offset
    n, m = rows.shape[1] - 1, len(equalities)
    if not (n + len(rows) - m == bounds.shape[1] == len(value) == room.shape[1] and len(offset) == len(outputs)):
        raise ValueError("residuals: the sizes of the constraints and of the results do not agree")
    if len(offset) > len(rows) - m:
        raise ValueError("residuals: there are more outputs than inequality constraints")
    largest, least = 0.0, math.inf
    point = np.full(n + 1, -1.0)  # [x, -1]
    point[:n] = value[:n]
    product = np.dot(rows, point)  # [A x - b, C x]
    for i in range(m):
        equalities[i] = abs(product[i])
        if equalities[i] > largest or equalities[i] != equalities[i]:  # NaN stays
            largest = equalities[i]
    value[n:] = product[m:]
    for i in range(len(offset)):
        outputs[i] = product[m + i] + offset[i]
    for i in range(len(value)):
        room[0, i], room[1, i] = value[i] - bounds[0, i], bounds[1, i] - value[i]
        for side in range(2):
            if room[side, i] < least or room[side, i] != room[side, i]:
                least = room[side, i]
    return least, largest
