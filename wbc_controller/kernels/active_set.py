"""The condensed system of a quadratic program with a known active set, and the residuals of its constraints."""

from __future__ import annotations

import math

import numpy as np

from wbc_controller.kernels.compiled import (
    INDICES,
    INTEGER,
    NUMBER,
    ROWS,
    ROWS_OUT,
    SIGNS,
    SIGNS_OUT,
    VECTOR,
    VECTOR_OUT,
    compiled,
    part,
)
from wbc_controller.records import Array

#: What `condensed` has found.
NOT_FOUND, SOLVED, NOTHING_FREE, WRONG_SET = 0, 1, 2, 3
#: A row counts as one that depends on those above it below this share of its square, in the metric of the cost.
DEPENDENT = 1.0e-12


@part
def _eliminate(head: Array, first: int, N: Array) -> bool:
    """N = H⁻¹ T for head = [H, T] with H (first, first): Gauss elimination with row pivoting; False if singular."""
    width = N.shape[1]
    H = head[:, :first].copy()
    for i in range(first):
        for j in range(width):
            N[i, j] = head[i, first + j]
    for column in range(first):
        pivot = column
        for i in range(column + 1, first):
            if abs(H[i, column]) > abs(H[pivot, column]):
                pivot = i
        if not abs(H[pivot, column]) > 0.0:
            return False
        if pivot != column:
            for j in range(first):
                H[pivot, j], H[column, j] = H[column, j], H[pivot, j]
            for j in range(width):
                N[pivot, j], N[column, j] = N[column, j], N[pivot, j]
        for i in range(column + 1, first):
            share = H[i, column] / H[column, column]
            for j in range(column + 1, first):
                H[i, j] -= share * H[column, j]
            for j in range(width):
                N[i, j] -= share * N[column, j]
    for i in range(first - 1, -1, -1):
        for k in range(i + 1, first):
            share = H[i, k]
            for j in range(width):
                N[i, j] -= share * N[k, j]
        for j in range(width):
            N[i, j] /= H[i, i]
    return True


@part
def _gram(transposed: Array, inverse: Array, K: Array) -> None:
    """The upper triangle of K += B D⁻¹ Bᵀ from Bᵀ (n, m) and D⁻¹ (n,)."""
    n, m = transposed.shape
    k = 0
    while k + 4 <= n:  # four products for each access to K
        d0, d1, d2, d3 = inverse[k], inverse[k + 1], inverse[k + 2], inverse[k + 3]
        b0, b1, b2, b3 = transposed[k], transposed[k + 1], transposed[k + 2], transposed[k + 3]
        for i in range(m):
            s0, s1, s2, s3 = d0 * b0[i], d1 * b1[i], d2 * b2[i], d3 * b3[i]
            for j in range(i, m):
                K[i, j] += (s0 * b0[j] + s1 * b1[j]) + (s2 * b2[j] + s3 * b3[j])
        k += 4
    for l in range(k, n):  # noqa: E741
        for i in range(m):
            s = inverse[l] * transposed[l, i]
            for j in range(i, m):
                K[i, j] += s * transposed[l, j]


@part
def _factored(K: Array, hard: int, rank: int) -> int:
    """K = UᵀU by Cholesky in its upper triangle; -1 if not definite.

    Where one of the first `hard` rows depends on those above it, its entry of U is infinite, so that it takes no part:
    its unknown becomes 0.

    Returns:
        How many of the first `rank` rows are independent.
    """
    m, independent = len(K), 0
    least = np.empty(hard)
    for i in range(hard):
        least[i] = DEPENDENT * K[i, i]
    for i in range(m):
        if i < hard and K[i, i] <= least[i]:  # not for NaN
            root = math.inf
        elif K[i, i] > 0.0:  # NaN too
            root = math.sqrt(K[i, i])
            if i < rank:
                independent += 1
        else:
            return -1
        for j in range(i, m):
            K[i, j] /= root
        if root == math.inf:
            K[i, i] = root
            continue
        for k in range(i + 1, m):
            share = K[i, k]
            for j in range(k, m):
                K[k, j] -= share * K[i, j]
    return independent


@part
def _solve_factored(K: Array, p: Array) -> None:
    """Solve UᵀU p = β, with U in the upper triangle of K, and p in place of β."""
    m = len(p)
    for i in range(m):
        p[i] /= K[i, i]
        for k in range(i + 1, m):
            p[k] -= K[i, k] * p[i]
    for i in range(m - 1, -1, -1):
        total = p[i]
        for j in range(i + 1, m):
            total -= K[i, j] * p[j]
        p[i] = total / K[i, i]


@part
def _move(z: Array, p: Array, B: Array, inverse: Array) -> None:
    """Compute z += d⁻¹ Bᵀp."""
    step = np.zeros(len(z))
    for i in range(len(p)):
        for j in range(len(z)):
            step[j] += p[i] * B[i, j]
    for j in range(len(z)):
        z[j] += inverse[j] * step[j]


@part
def _products(rows: Array, x: Array, out: Array) -> None:
    """Compute out = rows[:, :n] x for x (n,); four rows at a time, as one sum waits for its last addition."""
    count, n = len(rows), len(x)
    i = 0
    while i + 4 <= count:
        r0, r1, r2, r3 = rows[i], rows[i + 1], rows[i + 2], rows[i + 3]
        s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
        for j in range(n):
            s0 += r0[j] * x[j]
            s1 += r1[j] * x[j]
            s2 += r2[j] * x[j]
            s3 += r3[j] * x[j]
        out[i], out[i + 1], out[i + 2], out[i + 3] = s0, s1, s2, s3
        i += 4
    for l in range(i, count):  # noqa: E741
        s = 0.0
        for j in range(n):
            s += rows[l, j] * x[j]
        out[l] = s


@part
def _residuals(rows: Array, bounds: Array, value: Array, off: Array, room: Array) -> tuple[float, float]:
    m, n = len(off), rows.shape[1] - 1
    x = value[:n]
    _products(rows[:m], x, off)
    _products(rows[m:], x, value[n:])
    most, least = 0.0, math.inf
    for i in range(m):
        off[i] = abs(off[i] - rows[i, n])
        if off[i] > most or off[i] != off[i]:
            most = off[i]
    for side in range(2):
        sign = 1.0 - 2.0 * side
        for i in range(len(value)):
            left = sign * (value[i] - bounds[side, i])
            room[side, i] = left
            if left < least or left != left:
                least = left
    return least, most


@compiled(ROWS, ROWS, VECTOR_OUT, VECTOR_OUT, ROWS_OUT)
def residuals(rows: Array, bounds: Array, value: Array, off: Array, room: Array) -> tuple[float, float]:
    """Residuals of constraints A x = b, lower <= [x; C x] <= upper at a point x.

    Args:
        rows: [A, b] and below it [C, 0], (m_eq + m_in, n + 1).
        bounds: lower and upper bounds, (2, n + m_in).
        value: x, and after it room for C x, (n + m_in,).
        off: for |A x - b|, (m_eq,).
        room: for the distances from the lower and from the upper bounds, (2, n + m_in).

    Returns:
        The smallest room and the largest |A x - b|; NaN where one of them is.
    """
    return _residuals(rows, bounds, value, off, room)


@part
def _condense(whole: Array, first: int, N: Array, out: Array) -> None:
    """A row in terms of z: out = whole[first:] - whole[:first] N."""
    width = len(out)
    for j in range(width):
        out[j] = whole[first + j]
    for k in range(first):
        share = whole[k]
        for j in range(width):
            out[j] -= share * N[k, j]


@compiled(
    ROWS, VECTOR, INTEGER, VECTOR, VECTOR, NUMBER, ROWS, ROWS, INDICES, SIGNS, NUMBER, NUMBER, NUMBER,
    ROWS_OUT, ROWS_OUT, INTEGER, INTEGER, VECTOR_OUT, VECTOR_OUT, ROWS_OUT, VECTOR_OUT, SIGNS_OUT,
)  # fmt: skip
def condensed(
    stack: Array, slack: Array, first: int, inverse: Array, minus_target: Array, constant: float,
    rows: Array, bounds: Array, active: np.ndarray, sides: np.ndarray, feasible: float, precise: float,
    largest: float, N: Array, above: Array, count: int, kept: int, value: Array, off: Array, room: Array,
    multipliers: Array, other: np.ndarray,
) -> tuple[int, float, float, float]:  # fmt: skip
    """Minimize a sum of squares under the assumption that its active set is known (`solvers.active_set`).

    With the base accelerations eliminated by the last equality constraints, x_k = s - N z,

        z = t + d⁻¹ Bᵀp,    (B d⁻¹ Bᵀ + E) p = β - B t.

    The right-hand sides are one more column of B, for which z has -1 and minus_target 1. Rows of B that depend on those
    above them take no part; as their residuals are checked like all others, the solution is the minimizer even so.

    Of several levels of strict priority each is solved by a call, with the same `N` and `above`.

    Args:
        stack: [R, r] in its first rows, (≥ k, n + 1).
        slack: 1 / w of the rows R, (k,).
        first: number of columns that the last rows of A determine.
        inverse: d⁻¹, (n + 1,).
        minus_target: -t, (n + 1,).
        constant: the cost where all squares are zero.
        rows: [A, b] and below it [C, 0], (m_eq + m_in, n + 1).
        bounds: lower and upper bounds of [x; C x], (2, n + m_in).
        active: indices of the active ones among them, ascending, (j,).
        sides: 1 at the upper bound, -1 at the lower one, for each of them, (n + m_in,).
        feasible: largest violation of a constraint.
        precise: largest |A x - b| for which p is not refined by its own residual.
        largest: largest norm of p: beyond it the system is nearly singular.
        N: for N and s, (first, n + 1 - first).
        above: for the equality constraints in terms of z, and below them the rows that higher levels keep, with room
            for those that this one adds, (≥ m_eq - first, n + 1 - first).
        count: number of rows in `above`; 0 for the first level, which fills `N` and `above`.
        kept: number of rows of R, from the first on, that are added to `above` with their values at the solution.
        value: for [x; C x], (n + m_in,).
        off: for |A x - b|, (m_eq,).
        room: for the distances from the bounds, (2, n + m_in).
        multipliers: for those of the active constraints, where a higher level has not set them; zeros, (n + m_in,).
        other: for the sides to be tried next if the active set is wrong: without constraints whose multiplier has the
            wrong sign, and with those that are violated, (n + m_in,).

    Returns:
        `SOLVED`, `WRONG_SET`, `NOTHING_FREE` where the levels above have decided x already (then nothing is filled), or
        `NOT_FOUND`; the cost, the smallest room, and the largest |A x - b|.
    """
    n, end = stack.shape[1] - 1, len(off)
    own, soft, width = end - first, len(slack), n + 1 - first
    if count == 0:
        if first and not _eliminate(rows[own:end], first, N):
            return NOT_FOUND, 0.0, 0.0, 0.0
        for i in range(own):
            _condense(rows[i], first, N, above[i])
        top = own
    else:
        top = count
    hard = top + len(active)
    m = hard + soft
    B = np.zeros((m, width))  # of z and the right-hand sides
    for i in range(top):
        for j in range(width):
            B[i, j] = above[i, j]
    for i in range(len(active)):
        place, row = active[i], B[top + i]
        bound = bounds[1 if sides[place] > 0 else 0, place]
        if place >= n:
            _condense(rows[end + place - n], first, N, row)
        elif place < first:
            for j in range(width):
                row[j] = -N[place, j]
        else:
            row[place - first] = 1.0
        row[width - 1] += bound
    for i in range(soft):
        _condense(stack[i], first, N, B[hard + i])
    transposed = B.T.copy()
    weights, offset = inverse[first:], minus_target[first:]
    p = np.zeros(m)
    for k in range(width):
        for i in range(m):
            p[i] += offset[k] * transposed[k, i]
    beta = p.copy()
    K = np.zeros((m, m))
    _gram(transposed, weights, K)
    for i in range(soft):
        K[hard + i, hard + i] += slack[i]
    independent = _factored(K, hard, top)
    if independent < 0:
        return NOT_FOUND, 0.0, 0.0, 0.0
    if count and independent >= width - 1:
        return NOTHING_FREE, 0.0, 0.0, 0.0
    _solve_factored(K, p)
    size = 0.0
    for i in range(m):
        size += p[i] * p[i]
    if not size <= largest * largest:
        return NOT_FOUND, 0.0, 0.0, 0.0
    z, change, apart = -offset, p.copy(), np.empty(top - own)
    for refinement in range(3):
        _move(z, change, B, weights)
        _products(N, z, value[:first])
        for j in range(first):
            value[j] = -value[j]
        for j in range(width - 1):  # what copies a slice takes seconds to compile
            value[first + j] = z[j]
        least, most = _residuals(rows, bounds, value, off, room)
        _products(B[own:top], z, apart)
        lost = 0.0  # of the rows that higher levels keep
        for i in range(len(apart)):
            if abs(apart[i]) > lost or apart[i] != apart[i]:  # a NaN stays
                lost = abs(apart[i])
        if (most <= precise and lost <= precise) or refinement == 2:
            break
        # The rounding of z, not of p, is what d⁻¹ magnifies: z is moved on, not computed anew.
        _products(B, z, change)  # B z - β, as the last entry of z is -1
        for i in range(m):
            change[i] = -change[i] - (slack[i - hard] * p[i] if i >= hard else 0.0)
        _solve_factored(K, change)
        for i in range(m):
            p[i] += change[i]
    if not (most <= feasible and lost <= feasible and least == least):
        return NOT_FOUND, 0.0, least, most
    right = -least <= feasible
    for i in range(len(active)):
        if sides[active[i]] * p[top + i] > 0.0:
            right = False
    if not right:
        for i in range(len(sides)):
            other[i] = -1 if room[0, i] < -feasible else 1 if room[1, i] < -feasible else 0
        for i in range(len(active)):
            if not sides[active[i]] * p[top + i] > 0.0:
                other[active[i]] = sides[active[i]]
        return WRONG_SET, 0.0, least, most
    cost = 0.0
    for i in range(m):
        cost += p[i] * beta[i]
    for i in range(len(active)):
        if multipliers[active[i]] == 0.0:
            multipliers[active[i]] = -p[top + i]
    for i in range(kept):
        there, reached = above[top + i], 0.0
        for j in range(width - 1):
            there[j] = B[hard + i, j]
            reached += there[j] * z[j]
        there[width - 1] = reached
    # (z - t)ᵀd (z - t) = pᵀB (z - t) and B z = β - E p, so that all squares together are ½ pᵀ(β - B t).
    return SOLVED, constant + 0.5 * cost, least, most
