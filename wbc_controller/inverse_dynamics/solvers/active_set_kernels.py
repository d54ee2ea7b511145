"""Kernel of `solvers.active_set`."""

import math

import numpy as np

from wbc_controller.compilation import OutMatrix, OutVector, Signs, compiled, copy, copy_rows, part
from wbc_controller.inverse_dynamics.formulation.problem_kernels import Constraints, LeastSquares, dot, residuals
from wbc_controller.records import Array

NOT_FOUND, SOLVED, NOTHING_FREE, WRONG_SET = 0, 1, 2, 3
FEASIBLE = 1.0e-8  # constraint violation, as for DAQP
PRECISE = 1.0e-11  # residual without refinement
LARGEST = 1.0e8  # norm of a solution; usually 1e3
DEPENDENT = 1.0e-12  # relative square below which a row depends on the rows above


@part
def eliminate_base(rows: Array, base_map: Array) -> bool:
    """Compute [N, s] = H⁻¹ [T, b] of x_base = s - N z from [H, T, b] by Gauss-Jordan; return False for singular H."""
    count, matrix = len(rows), rows.copy()
    for column in range(count):
        pivot = column
        for i in range(column + 1, count):
            if abs(matrix[i, column]) > abs(matrix[pivot, column]):
                pivot = i
        if not abs(matrix[pivot, column]) > 0.0:
            return False
        inverse = 1.0 / matrix[pivot, column]
        for j in range(column, matrix.shape[1]):  # earlier columns are those of the identity
            swapped = matrix[column, j]
            matrix[column, j] = inverse * matrix[pivot, j]
            if pivot != column:
                matrix[pivot, j] = swapped
        for i in range(count):
            if i != column:
                factor = matrix[i, column]
                for j in range(column, matrix.shape[1]):
                    matrix[i, j] -= factor * matrix[column, j]
    copy_rows(matrix[:, count:], base_map)
    return True


@part
def reduce_rows(rows: Array, base_map: Array, out: Array) -> None:
    """Write rows [H, T] of x in terms of z, T - H N, with right-hand sides in the last column."""
    base = len(base_map)
    if base == 6:  # floating base, in one pass
        n0, n1, n2, n3, n4, n5 = base_map[0], base_map[1], base_map[2], base_map[3], base_map[4], base_map[5]
    for i in range(len(rows)):
        row, rest, target = rows[i], rows[i, base:], out[i]
        if base == 6:
            h0, h1, h2, h3, h4, h5 = row[0], row[1], row[2], row[3], row[4], row[5]
            for j in range(len(target)):
                target[j] = rest[j] - (h0 * n0[j] + h1 * n1[j] + h2 * n2[j] + (h3 * n3[j] + h4 * n4[j] + h5 * n5[j]))
            continue
        copy(rest, target)
        for k in range(base):
            factor, source = row[k], base_map[k]
            for j in range(len(target)):
                target[j] -= factor * source[j]


@part
def reduce_bound(place: int, sign: int, constraints: Constraints, equalities: int, base_map: Array, out: Array) -> None:
    """Write an active bound of entry `place` of [x; C x] in terms of z; `sign` as in `ActiveSet.side`."""
    base, n = len(base_map), constraints.rows.shape[1] - 1
    if place >= n:
        row = equalities + place - n
        reduce_rows(constraints.rows[row : row + 1], base_map, out.reshape(1, len(out)))
    elif place < base:
        for j in range(len(out)):
            out[j] = -base_map[place, j]
    else:
        out[:] = 0.0
        out[place - base] = 1.0
    out[len(out) - 1] += constraints.bounds[1 if sign > 0 else 0, place]


@part
def assemble(
    cost: LeastSquares, upper: Array, active: np.ndarray, sides: np.ndarray, equalities: int, base_map: Array
) -> Array:
    """Return B: rows of the equality constraints and of the levels above, active bounds, and cost rows."""
    top, width = upper.shape
    hard = top + len(active)
    B = np.empty((hard + len(cost.weights), width))
    copy_rows(upper, B)
    for i in range(len(active)):
        reduce_bound(active[i], sides[0, active[i]], cost.constraints, equalities, base_map, B[top + i])
    reduce_rows(cost.rows[: len(cost.weights)], base_map, B[hard:])
    return B


@part
def system_matrix(B: Array, inverse: Array, first_soft: int, weights: Array) -> Array:
    """Compute K = B D⁻¹ Bᵀ + E, with E = 1 / w in the cost rows from `first_soft` on."""
    K: Array = np.dot(B * inverse, B.T)
    for i in range(len(weights)):
        K[first_soft + i, first_soft + i] += 1.0 / weights[i]
    return K


@part
def factorize(K: Array, hard: int, inverse: Array) -> bool:
    """Replace K by U of K = UᵀU (Cholesky), in the upper triangle; return False if K is not positive definite.

    If one of the first `hard` rows depends on the rows above, its unknown becomes 0. `inverse` receives 1 / Uᵢᵢ, or 0.
    """
    m = len(K)
    for i in range(m):
        inverse[i] = DEPENDENT * K[i, i] if i < hard else -1.0
    for i in range(m):
        row, fours = K[i, i:], i - i % 4
        for k in range(0, fours, 4):  # subtract the rows above, four at a time
            a, b, c, d = K[k, i:], K[k + 1, i:], K[k + 2, i:], K[k + 3, i:]
            a0, b0, c0, d0 = a[0], b[0], c[0], d[0]
            for j in range(len(row)):
                row[j] -= (a0 * a[j] + b0 * b[j]) + (c0 * c[j] + d0 * d[j])
        for k in range(fours, i):
            factor, source = K[k, i], K[k, i:]
            for j in range(len(row)):
                row[j] -= factor * source[j]
        square = row[0]
        if square <= inverse[i]:
            inverse[i] = 0.0
        elif square > 0.0:
            inverse[i] = 1.0 / math.sqrt(square)
        else:  # also NaN
            return False
        row *= inverse[i]
    return True


@part
def solve_factorized(U: Array, inverse: Array, p: Array) -> None:
    """Solve UᵀU p = β in place of β."""
    m = len(p)
    for i in range(m):
        p[i] *= inverse[i]
        factor, row, below = p[i], U[i, i + 1 :], p[i + 1 :]
        for j in range(len(row)):
            below[j] -= factor * row[j]
    for i in range(m - 1, -1, -1):
        p[i] = (p[i] - dot(U[i, i + 1 :], p[i + 1 :])) * inverse[i]


@part
def residual(B: Array, z: Array, p: Array, first_soft: int, weights: Array) -> Array:
    """Compute the residual β - B z - E p, (m,), from [B, β] and [z, -1]."""
    out: Array = -np.dot(B, z)
    for i in range(len(weights)):
        out[first_soft + i] -= p[first_soft + i] / weights[i]
    return out


@part
def solve_refined(
    B: Array, K: Array, pivots: Array, inverse: Array, hard: int, weights: Array, beta: Array, z: Array, p: Array
) -> tuple[bool, Array]:
    """Solve K p = β and z = t + D⁻¹ Bᵀp in place, from z = t and p = 0, with the factors of K.

    The refinement is needed as D⁻¹ magnifies rounding errors of z. Returns False if p is too large, and the residual.
    """
    left, last = beta, len(z) - 1
    for _ in range(3):
        correction = left.copy()
        solve_factorized(K, pivots, correction)
        p += correction
        if not dot(p, p) <= LARGEST * LARGEST:
            return False, left
        step = np.dot(correction, B)
        for j in range(last):  # without the last entry, -1
            z[j] += inverse[j] * step[j]
        left = residual(B, z, p, hard, weights)
        if largest_of(left) <= PRECISE:
            break
    return True, left


@part
def largest_of(values: Array) -> float:
    """Return the largest magnitude, or NaN; 0 without values."""
    largest = 0.0
    for value in values:
        if abs(value) > largest or value != value:
            largest = abs(value)
    return largest


@part
def next_set(sides: np.ndarray, active: np.ndarray, p: Array, to_lower: Array, to_upper: Array) -> None:
    """Write the next active set to row 1 of `sides`: violated bounds, and active ones with -p of right sign."""
    for i in range(len(to_lower)):
        sides[1, i] = -1 if to_lower[i] < -FEASIBLE else 1 if to_upper[i] < -FEASIBLE else 0
    for i in range(len(active)):
        if not sides[0, active[i]] * p[i] > 0.0:
            sides[1, active[i]] = sides[0, active[i]]


@compiled
def solve_condensed(
    cost: LeastSquares, sides: Signs, memory: OutMatrix, above: int, kept: int, multipliers: OutVector, found: OutVector
) -> tuple[int, float, float, float]:
    """Minimize a sum of squares for a given active set.

    The system is that of `ActiveSet`; the last column of B is β, and the last entry of z is -1. Dependent rows of B are
    ignored, but their residuals checked. Strict priorities use one call per level with the same `memory` and results.

    Args:
        cost: of the level, with the constraints.
        sides: `ActiveSet.side`; row 1 receives the next set, (2, n + m_in).
        memory: as `LevelWorkspace.rows`.
        above: number of rows in `memory` after [N, s]; 0 for the first level.
        kept: number of leading cost rows appended to `memory`.
        multipliers: out: of active bounds not set by a higher level, (n + m_in,).
        found: out: `formulation.problem.Residuals.memory`.

    Returns:
        `SOLVED`, `WRONG_SET`, `NOTHING_FREE` if the levels above determine x, or `NOT_FOUND`; the cost, the smallest
        room, and the largest |A x - b|.
    """
    constraints = cost.constraints
    rows, weights, base, total = constraints.rows, cost.weights, cost.base, len(multipliers)
    end = len(rows) - (total - (rows.shape[1] - 1))  # of the equality constraints
    soft, own, width, last = len(weights), end - cost.base, rows.shape[1] - cost.base, rows.shape[1] - 1 - cost.base
    if not (cost.rows.shape[1] == rows.shape[1] and len(cost.diagonal) == len(cost.target) == rows.shape[1] - 1):
        raise ValueError("solve_condensed: cost and constraints have different numbers of variables")
    if not (len(cost.rows) >= soft >= kept and total == sides.shape[1] and own >= 0 and len(found) >= 3 * total):
        raise ValueError("solve_condensed: sizes of cost or results differ from the constraints")
    base_map, upper_rows = memory[:base], memory[base:]
    if not (memory.shape[1] == width and len(memory) >= base + (above if above else own) + kept):
        raise ValueError("solve_condensed: memory for the levels is too small")
    if above == 0:
        if not eliminate_base(rows[own:end], base_map):
            return NOT_FOUND, 0.0, 0.0, 0.0
        reduce_rows(rows[:own], base_map, upper_rows)
        multipliers[:] = 0.0
    active, top = np.flatnonzero(sides[0]), above if above else own
    hard = top + len(active)
    B = assemble(cost, upper_rows[:top], active, sides, end, base_map)
    inverse, z, diagonal = np.zeros(width), np.empty(width), cost.diagonal[base:]
    copy(cost.target[base:], z)
    z[last] = -1.0
    for j in range(last):
        inverse[j] = 1.0 / diagonal[j]
    K, pivots = system_matrix(B, inverse, hard, weights), np.empty(len(B))
    if not factorize(K, hard, pivots):
        return NOT_FOUND, 0.0, 0.0, 0.0
    if above and np.count_nonzero(pivots[:top]) >= last:
        return NOTHING_FREE, 0.0, 0.0, 0.0
    p = np.zeros(len(B))
    beta = residual(B, z, p, hard, weights)
    bounded, left = solve_refined(B, K, pivots, inverse, hard, weights, beta, z, p)
    if not bounded:
        return NOT_FOUND, 0.0, 0.0, 0.0
    lost = largest_of(left[own:top])  # of the kept rows
    for i in range(base):
        found[i] = -dot(base_map[i], z)
    copy(z[:last], found[base:])
    least, largest = residuals(constraints, found)
    if not (largest <= FEASIBLE and lost <= FEASIBLE and least == least):
        return NOT_FOUND, 0.0, least, largest
    right = -least <= FEASIBLE
    for i in range(len(active)):
        right = right and not sides[0, active[i]] * p[top + i] > 0.0
    if not right:
        next_set(sides, active, p[top:hard], found[total : 2 * total], found[2 * total : 3 * total])
        return WRONG_SET, 0.0, least, largest
    for i in range(len(active)):
        if multipliers[active[i]] == 0.0:
            multipliers[active[i]] = -p[top + i]
    for i in range(kept):
        copy(B[hard + i, :last], upper_rows[top + i])
        upper_rows[top + i, last] = dot(B[hard + i, :last], z[:last])
    # (z - t)ᵀD (z - t) = pᵀB (z - t) and B z = β - E p: the sum of squares is ½ pᵀ(β - B t).
    return SOLVED, 0.5 * dot(p, beta), least, largest
