"""The condensed system of a quadratic program with a known active set.

Inner loops work on four rows at a time, with a variable for each sum: the compiler makes vectors of them, and each sum
is still taken in the order in which it is written.
"""

from __future__ import annotations

import math

import numpy as np

from wbc_controller.compiled import (
    INTEGER,
    NUMBER,
    TABLE,
    VECTOR_OUT,
    compile_all,
    compiled,
    first_rows,
    matrix,
    part,
    signs,
    vector,
)
from wbc_controller.inverse_dynamics.formulation.residual_kernels import fill_residuals, product, violation
from wbc_controller.records import Array

#: What `condensed` has found.
NOT_FOUND, SOLVED, NOTHING_FREE, WRONG_SET = 0, 1, 2, 3
#: A row counts as one that depends on those above it below this share of its square, in the metric of the cost.
DEPENDENT = 1.0e-12


@part
def _eliminate(head: Array, first: int, H: Array, N: Array) -> bool:
    """N = H⁻¹ T for head = [H, T] with H (first, first): Gauss elimination with row pivoting; False if singular."""
    width = N.shape[1]
    for i in range(first):
        for j in range(first):
            H[i, j] = head[i, j]
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
            if share != 0.0:
                for j in range(column + 1, first):
                    H[i, j] -= share * H[column, j]
                for j in range(width):
                    N[i, j] -= share * N[column, j]
    for i in range(first - 1, -1, -1):
        for k in range(i + 1, first):
            share = H[i, k]
            if share != 0.0:
                for j in range(width):
                    N[i, j] -= share * N[k, j]
        inverse = 1.0 / H[i, i]
        for j in range(width):
            N[i, j] *= inverse
    return True


@part
def _reduced(row: Array, N: Array, out: Array) -> None:
    """A row of x in the variables that are left: out = T - H N for row = [H, T]."""
    first, width = N.shape
    if first == 6:  # a floating base, in one pass
        h0, h1, h2, h3, h4, h5 = row[0], row[1], row[2], row[3], row[4], row[5]
        n0, n1, n2, n3, n4, n5 = N[0], N[1], N[2], N[3], N[4], N[5]
        rest = row[6:]
        for j in range(width):
            low, high = h0 * n0[j] + h1 * n1[j] + h2 * n2[j], h3 * n3[j] + h4 * n4[j] + h5 * n5[j]
            out[j] = rest[j] - (low + high)
        return
    for j in range(width):
        out[j] = row[first + j]
    for k in range(first):
        for j in range(width):
            out[j] -= row[k] * N[k, j]


@part
def _gram(B: Array, weights: Array, scaled: Array, K: Array) -> None:
    """The blocks on and above the diagonal of K = B D⁻¹ Bᵀ.

    Args:
        B: (m / 4, n, 4): rows in blocks of four, each by columns.
        weights: D⁻¹, (n,).
        scaled: for a block times D⁻¹, (n, 4).
        K: for the result, (m, m).
    """
    blocks, n = B.shape[0], B.shape[1]
    for I in range(blocks):  # noqa: E741
        X = B[I]
        for k in range(n):
            for a in range(4):
                scaled[k, a] = weights[k] * X[k, a]
        for J in range(I, blocks):
            Y = B[J]
            a00, a01, a02, a03 = 0.0, 0.0, 0.0, 0.0
            a10, a11, a12, a13 = 0.0, 0.0, 0.0, 0.0
            a20, a21, a22, a23 = 0.0, 0.0, 0.0, 0.0
            a30, a31, a32, a33 = 0.0, 0.0, 0.0, 0.0
            for k in range(n):
                x0, x1, x2, x3 = scaled[k, 0], scaled[k, 1], scaled[k, 2], scaled[k, 3]
                y0, y1, y2, y3 = Y[k, 0], Y[k, 1], Y[k, 2], Y[k, 3]
                a00 += x0 * y0
                a01 += x0 * y1
                a02 += x0 * y2
                a03 += x0 * y3
                a10 += x1 * y0
                a11 += x1 * y1
                a12 += x1 * y2
                a13 += x1 * y3
                a20 += x2 * y0
                a21 += x2 * y1
                a22 += x2 * y2
                a23 += x2 * y3
                a30 += x3 * y0
                a31 += x3 * y1
                a32 += x3 * y2
                a33 += x3 * y3
            i, j = 4 * I, 4 * J
            K[i, j], K[i, j + 1], K[i, j + 2], K[i, j + 3] = a00, a01, a02, a03
            K[i + 1, j], K[i + 1, j + 1], K[i + 1, j + 2], K[i + 1, j + 3] = a10, a11, a12, a13
            K[i + 2, j], K[i + 2, j + 1], K[i + 2, j + 2], K[i + 2, j + 3] = a20, a21, a22, a23
            K[i + 3, j], K[i + 3, j + 1], K[i + 3, j + 2], K[i + 3, j + 3] = a30, a31, a32, a33


@part
def _pivot(square: float, least: float) -> float:
    """1 / Uᵢᵢ; 0 for a row that depends on those above it, NaN where the matrix is not definite."""
    if square <= least:  # not for NaN
        return 0.0
    return 1.0 / math.sqrt(square) if square > 0.0 else math.nan


@part
def _factored(K: Array, hard: int, rank: int, least: Array, inverse: Array) -> int:
    """K = UᵀU by Cholesky in its upper triangle, block by block of four; -1 if not definite.

    Where one of the first `hard` rows depends on those above it, its unknown takes no part and becomes 0.

    Args:
        K: symmetric, (m, m); U comes in its place.
        hard: number of rows that may depend on others.
        rank: number of rows that are counted.
        least: memory, (m,).
        inverse: for 1 / Uᵢᵢ, 0 where a row takes no part, (m,).

    Returns:
        How many of the first `rank` rows are independent.
    """
    m = len(K)
    for i in range(m):
        least[i] = DEPENDENT * K[i, i] if i < hard else -1.0
    for i in range(0, m, 4):
        for j in range(i, m, 4):
            r0, r1, r2, r3 = K[i, j : j + 4], K[i + 1, j : j + 4], K[i + 2, j : j + 4], K[i + 3, j : j + 4]
            a00, a01, a02, a03 = r0[0], r0[1], r0[2], r0[3]
            a10, a11, a12, a13 = r1[0], r1[1], r1[2], r1[3]
            a20, a21, a22, a23 = r2[0], r2[1], r2[2], r2[3]
            a30, a31, a32, a33 = r3[0], r3[1], r3[2], r3[3]
            for k in range(i):
                x, y = K[k, i : i + 4], K[k, j : j + 4]
                x0, x1, x2, x3 = x[0], x[1], x[2], x[3]
                y0, y1, y2, y3 = y[0], y[1], y[2], y[3]
                a00 -= x0 * y0
                a01 -= x0 * y1
                a02 -= x0 * y2
                a03 -= x0 * y3
                a10 -= x1 * y0
                a11 -= x1 * y1
                a12 -= x1 * y2
                a13 -= x1 * y3
                a20 -= x2 * y0
                a21 -= x2 * y1
                a22 -= x2 * y2
                a23 -= x2 * y3
                a30 -= x3 * y0
                a31 -= x3 * y1
                a32 -= x3 * y2
                a33 -= x3 * y3
            if j == i:
                s0 = _pivot(a00, least[i])
                u01, u02, u03 = s0 * a01, s0 * a02, s0 * a03
                s1 = _pivot(a11 - u01 * u01, least[i + 1])
                u12, u13 = s1 * (a12 - u01 * u02), s1 * (a13 - u01 * u03)
                s2 = _pivot(a22 - u02 * u02 - u12 * u12, least[i + 2])
                u23 = s2 * (a23 - u02 * u03 - u12 * u13)
                s3 = _pivot(a33 - u03 * u03 - u13 * u13 - u23 * u23, least[i + 3])
                if not (s0 >= 0.0 and s1 >= 0.0 and s2 >= 0.0 and s3 >= 0.0):
                    return -1
                inverse[i], inverse[i + 1], inverse[i + 2], inverse[i + 3] = s0, s1, s2, s3
                r0[1], r0[2], r0[3], r1[2], r1[3], r2[3] = u01, u02, u03, u12, u13, u23
                continue
            a00, a01, a02, a03 = s0 * a00, s0 * a01, s0 * a02, s0 * a03
            a10, a11, a12, a13 = a10 - u01 * a00, a11 - u01 * a01, a12 - u01 * a02, a13 - u01 * a03
            a10, a11, a12, a13 = s1 * a10, s1 * a11, s1 * a12, s1 * a13
            a20, a21, a22, a23 = a20 - u02 * a00, a21 - u02 * a01, a22 - u02 * a02, a23 - u02 * a03
            a20, a21, a22, a23 = a20 - u12 * a10, a21 - u12 * a11, a22 - u12 * a12, a23 - u12 * a13
            a20, a21, a22, a23 = s2 * a20, s2 * a21, s2 * a22, s2 * a23
            a30, a31, a32, a33 = a30 - u03 * a00, a31 - u03 * a01, a32 - u03 * a02, a33 - u03 * a03
            a30, a31, a32, a33 = a30 - u13 * a10, a31 - u13 * a11, a32 - u13 * a12, a33 - u13 * a13
            a30, a31, a32, a33 = a30 - u23 * a20, a31 - u23 * a21, a32 - u23 * a22, a33 - u23 * a23
            a30, a31, a32, a33 = s3 * a30, s3 * a31, s3 * a32, s3 * a33
            r0[0], r0[1], r0[2], r0[3] = a00, a01, a02, a03
            r1[0], r1[1], r1[2], r1[3] = a10, a11, a12, a13
            r2[0], r2[1], r2[2], r2[3] = a20, a21, a22, a23
            r3[0], r3[1], r3[2], r3[3] = a30, a31, a32, a33
    independent = 0
    for i in range(rank):
        independent += inverse[i] > 0.0
    return independent


@part
def _solve_factored(U: Array, inverse: Array, p: Array) -> None:
    """Solve UᵀU p = β, with p in place of β; m is a multiple of four."""
    m = len(p)
    for i in range(0, m, 4):
        r0, r1, r2, r3 = U[i, i:], U[i + 1, i:], U[i + 2, i:], U[i + 3, i:]
        own = p[i:]
        x0 = own[0] * inverse[i]
        x1 = (own[1] - r0[1] * x0) * inverse[i + 1]
        x2 = (own[2] - r0[2] * x0 - r1[2] * x1) * inverse[i + 2]
        x3 = (own[3] - r0[3] * x0 - r1[3] * x1 - r2[3] * x2) * inverse[i + 3]
        own[0], own[1], own[2], own[3] = x0, x1, x2, x3
        for k in range(4, m - i):
            own[k] -= (r0[k] * x0 + r1[k] * x1) + (r2[k] * x2 + r3[k] * x3)
    for i in range(m - 4, -1, -4):
        r0, r1, r2, r3 = U[i, i:], U[i + 1, i:], U[i + 2, i:], U[i + 3, i:]
        own = p[i:]
        s0, s1, s2, s3 = own[0], own[1], own[2], own[3]
        for k in range(4, m - i):
            x = own[k]
            s0 -= r0[k] * x
            s1 -= r1[k] * x
            s2 -= r2[k] * x
            s3 -= r3[k] * x
        s3 *= inverse[i + 3]
        s2 = (s2 - r2[3] * s3) * inverse[i + 2]
        s1 = (s1 - r1[3] * s3 - r1[2] * s2) * inverse[i + 1]
        s0 = (s0 - r0[3] * s3 - r0[2] * s2 - r0[1] * s1) * inverse[i]
        own[0], own[1], own[2], own[3] = s0, s1, s2, s3


@part
def _move(z: Array, p: Array, B: Array, weights: Array) -> None:
    """Compute z += d⁻¹ Bᵀp, with B in blocks."""
    blocks, n = B.shape[0], B.shape[1]
    for k in range(n):
        total = 0.0
        for I in range(blocks):  # noqa: E741
            row, own = B[I, k], p[4 * I :]
            total += (row[0] * own[0] + row[1] * own[1]) + (row[2] * own[2] + row[3] * own[3])
        z[k] += weights[k] * total


@part
def _block_products(B: Array, z: Array, out: Array) -> None:
    """Compute out = B z, with B in blocks."""
    blocks, n = B.shape[0], B.shape[1]
    for I in range(blocks):  # noqa: E741
        X, own = B[I], out[4 * I :]
        s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
        for k in range(n):
            x = z[k]
            s0 += X[k, 0] * x
            s1 += X[k, 1] * x
            s2 += X[k, 2] * x
            s3 += X[k, 3] * x
        own[0], own[1], own[2], own[3] = s0, s1, s2, s3


@part
def _scatter(row: Array, B: Array, i: int) -> None:
    """Row i of B, which is in blocks of four."""
    block = B[i // 4, :, i % 4]
    for j in range(len(row)):
        block[j] = row[j]


@compiled(TABLE, NUMBER, VECTOR_OUT, INTEGER, INTEGER, VECTOR_OUT)
def condensed(
    table: np.ndarray, constant: float, work: Array, count: int, kept: int, found: Array
) -> tuple[int, float, float, float]:  # fmt: skip
    """Minimize a sum of squares under the assumption that its active set is known (`solvers.active_set`).

    With the base accelerations eliminated by the last equality constraints, x_k = s - N z,

        z = t + d⁻¹ Bᵀp,    (B d⁻¹ Bᵀ + E) p = β - B t.

    The right-hand sides are one more column of B, for which z has -1 and minus_target 1. Rows of B that depend on those
    above them take no part; as their residuals are checked like all others, the solution is the minimizer even so.

    Of several levels of strict priority each is solved by a call, with the same `work` and `found`.

    Args:
        table: the number of columns n, of rows R (k), of columns that the last rows of A determine (first), of rows of
            A (m_eq) and of C (m_in), and of outputs; and, in this order,
            stack: [R, r] in its first rows, (≥ k, n + 1).
            slack: 1 / w of the rows R, (k,).
            inverse: d⁻¹, (n + 1,).
            minus_target: -t, (n + 1,).
            rows: [A, b] and below it [C, 0], (m_eq + m_in, n + 1).
            bounds: lower and upper bounds of [x; C x], (2, n + m_in).
            sides: which of them are active: 1 at the upper bound, -1 at the lower one, else 0; and below them, for the
                sides to be tried next if the active set is wrong: without constraints whose multiplier has the wrong
                sign, and with those that are violated, (2, n + m_in).
            offset: r of the outputs C x + r of its first rows.
            limits: largest violation of a constraint; largest residual of the condensed system's rows for which p is
                not refined; and largest norm of p: beyond it the system is nearly singular, (3,).
        constant: the cost where all squares are zero.
        work: N and s; the equality constraints in terms of z, and below them the rows that higher levels keep, with
            room for those that this one adds, rows of n + 1 - first, one after the other.
        count: number of these rows below N; 0 for the first level, which fills N and the equality constraints.
        kept: number of rows of R, from the first on, that are added with their values at the solution.
        found: for [x; C x], for the multipliers of the active constraints, where a higher level has not set them, both
            (n + m_in,), for the distances from the bounds, (2, n + m_in), for |A x - b|, (m_eq,), and for the outputs.

    Returns:
        `SOLVED`, `WRONG_SET`, `NOTHING_FREE` where the levels above have decided x already (then nothing is filled), or
        `NOT_FOUND`; the cost, the smallest room, and the largest violation of a constraint.
    """
    n, soft, first, end, total = table[0], table[1], table[2], table[3], table[0] + table[4]
    stack, slack = first_rows(table, 6, soft, n + 1), vector(table, 7, soft)
    inverse, minus_target = vector(table, 8, n + 1), vector(table, 9, n + 1)
    rows, bounds = matrix(table, 10, end + table[4], n + 1), matrix(table, 11, 2, total)
    if len(found) != 4 * total + end + table[5]:
        raise ValueError("condensed: found has another size than the constraints ask for")
    if len(work) < (first + (count if count else end - first) + kept) * (n + 1 - first):
        raise ValueError("condensed: work is too small")
    value, multipliers = found[:total], found[total : 2 * total]
    room, off = found[2 * total : 4 * total].reshape(2, total), found[4 * total : 4 * total + end]
    both, constants, limits = signs(table, 12, 2, total), vector(table, 13, table[5]), vector(table, 14, 3)
    sides, other, feasible, precise, largest = both[0], both[1], limits[0], limits[1], limits[2]
    number = 0
    for i in range(total):
        number += sides[i] != 0
    active, number = np.empty(number, dtype=np.int64), 0
    for i in range(total):
        if sides[i] != 0:
            active[number] = i
            number += 1
    width, own = n + 1 - first, end - first
    top = count if count else own
    hard = top + len(active)
    m = hard + soft
    blocks = (m + 3) // 4
    size = 4 * blocks
    N, above = work[: first * width].reshape(first, width), work[first * width :]
    above = above[: (len(above) // width) * width].reshape(len(above) // width, width)
    # One piece of memory for all.
    memory = np.empty((6 + size) * width + size * (size + 5) + first * first)
    B, memory = memory[: size * width].reshape(blocks, width, 4), memory[size * width :]
    K, memory = memory[: size * size].reshape(size, size), memory[size * size :]
    scaled, memory = memory[: 4 * width].reshape(width, 4), memory[4 * width :]
    H, memory = memory[: first * first].reshape(first, first), memory[first * first :]
    z, row, memory = memory[:width], memory[width : 2 * width], memory[2 * width :]
    p, change, beta = memory[:size], memory[size : 2 * size], memory[2 * size : 3 * size]
    diagonal, least_squares = memory[3 * size : 4 * size], memory[4 * size :]
    if count == 0:
        if first and not _eliminate(rows[own:end], first, H, N):
            return NOT_FOUND, 0.0, 0.0, 0.0
        for i in range(own):
            _reduced(rows[i], N, above[i])
        for i in range(total):
            multipliers[i] = 0.0
    for i in range(top):
        _scatter(above[i], B, i)
    for i in range(len(active)):
        place = active[i]
        if place >= n:
            _reduced(rows[end + place - n], N, row)
        else:
            for j in range(width):
                row[j] = -N[place, j] if place < first else 0.0
            if place >= first:
                row[place - first] = 1.0
        row[width - 1] += bounds[1 if sides[place] > 0 else 0, place]
        _scatter(row, B, top + i)
    for i in range(soft):
        _reduced(stack[i], N, row)
        _scatter(row, B, hard + i)
    for j in range(width):
        row[j] = 0.0
    for i in range(m, size):  # what fills the last block
        _scatter(row, B, i)
    weights, offset = inverse[first:], minus_target[first:]
    _block_products(B, offset, p)
    _gram(B, weights, scaled, K)
    for i in range(soft):
        K[hard + i, hard + i] += slack[i]
    for i in range(m, size):
        K[i, i] = 1.0
    independent = _factored(K, hard, top, least_squares, diagonal)
    if independent < 0:
        return NOT_FOUND, 0.0, 0.0, 0.0
    if count and independent >= width - 1:
        return NOTHING_FREE, 0.0, 0.0, 0.0
    for i in range(size):
        beta[i] = p[i]
    _solve_factored(K, diagonal, p)
    norm = 0.0
    for i in range(m):
        norm += p[i] * p[i]
    if not norm <= largest * largest:
        return NOT_FOUND, 0.0, 0.0, 0.0
    for j in range(width):
        z[j] = -offset[j]
    _move(z, p, B, weights)
    for refinement in range(3):
        # The rounding of z, not of p, is what d⁻¹ magnifies: z is moved on, not computed anew.
        _block_products(B, z, change)  # B z - β, as the last entry of z is -1
        worst = 0.0
        for i in range(size):
            change[i] = -change[i] - (slack[i - hard] * p[i] if hard <= i < m else 0.0)
            worst = max(worst, abs(change[i]))
        if worst <= precise or refinement == 2:
            break
        _solve_factored(K, diagonal, change)
        for i in range(m):
            p[i] += change[i]
        _move(z, change, B, weights)
    lost = 0.0  # of the rows that higher levels keep
    for i in range(own, top):
        if abs(change[i]) > lost or change[i] != change[i]:  # a NaN stays
            lost = abs(change[i])
    for i in range(first):
        value[i] = -product(N[i], z)
    for j in range(width - 1):  # what copies a slice takes seconds to compile
        value[first + j] = z[j]
    least, most = fill_residuals(rows, bounds, constants, value, room, off, found[4 * total + end :])
    worst_violation = violation(least, most)
    if not (most <= feasible and lost <= feasible and least == least):
        return NOT_FOUND, 0.0, least, worst_violation
    right = -least <= feasible
    for i in range(len(active)):
        if sides[active[i]] * p[top + i] > 0.0:
            right = False
    if not right:
        for i in range(total):
            other[i] = -1 if room[0, i] < -feasible else 1 if room[1, i] < -feasible else 0
        for i in range(len(active)):
            if not sides[active[i]] * p[top + i] > 0.0:
                other[active[i]] = sides[active[i]]
        return WRONG_SET, 0.0, least, worst_violation
    cost = 0.0
    for i in range(m):
        cost += p[i] * beta[i]
    for i in range(len(active)):
        if multipliers[active[i]] == 0.0:
            multipliers[active[i]] = -p[top + i]
    for i in range(kept):
        there = above[top + i]
        block, reached = B[(hard + i) // 4, :, (hard + i) % 4], 0.0
        for j in range(width - 1):
            there[j] = block[j]
            reached += there[j] * z[j]
        there[width - 1] = reached
    # (z - t)ᵀd (z - t) = pᵀB (z - t) and B z = β - E p, so that all squares together are ½ pᵀ(β - B t).
    return SOLVED, constant + 0.5 * cost, least, worst_violation


compile_all()
