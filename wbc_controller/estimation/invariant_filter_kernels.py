"""Prediction and correction of the invariant filter (`estimation.invariant_filter`, which has the symbols)."""

from __future__ import annotations

import math

import numpy as np

from wbc_controller.compiled import (
    ANY_VECTOR,
    INDICES,
    NUMBER,
    ROWS,
    ROWS_OUT,
    VECTOR,
    VECTOR_OUT,
    compile_all,
    compiled,
    part,
)
from wbc_controller.records import Array

#: Angle below which series take the place of quotients, rad.
_SMALL = 1.0e-6


@part
def _turned(w: Array, a: float, b: float, x: Array, out: Array) -> None:
    """The product (1 + a W + b W²) x with W = w ×, for a vector x, (3,)."""
    cx, cy, cz = w[1] * x[2] - w[2] * x[1], w[2] * x[0] - w[0] * x[2], w[0] * x[1] - w[1] * x[0]
    out[0] = x[0] + a * cx + b * (w[1] * cz - w[2] * cy)
    out[1] = x[1] + a * cy + b * (w[2] * cx - w[0] * cz)
    out[2] = x[2] + a * cz + b * (w[0] * cy - w[1] * cx)


@part
def _coefficients(w: Array) -> tuple[float, float, float]:
    """The series sin θ / θ, (1 - cos θ) / θ² and (θ - sin θ) / θ³ of θ = |w|."""
    angle = math.sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    if angle < _SMALL:
        return 1.0, 0.5, 1.0 / 6.0
    return math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle**2, (angle - math.sin(angle)) / angle**3


@part
def _require_state(R: Array, columns: Array, gyroscope_bias: Array, accelerometer_bias: Array, P: Array) -> None:
    """Require the sizes of a state of the filter to agree.

    Raises:
        ValueError: if they do not.
    """
    size = 9 + 3 * columns.shape[1]
    if not (R.shape == (3, 3) and columns.shape[0] == 3 and columns.shape[1] >= 2 and P.shape == (size, size)):
        raise ValueError("invariant filter: R, columns and P have sizes that do not agree")
    if not (len(gyroscope_bias) == 3 and len(accelerometer_bias) == 3):
        raise ValueError("invariant filter: a bias has another size than 3")


@part
def _carried(P: Array, G: Array, R: Array, gravity: Array, dt: float, out: Array) -> None:
    """Φ P, with Φ = 1 + A dt: its few blocks beside the diagonal, row by row."""
    n, end = len(P), G.shape[1]
    for i in range(end):
        a, b, c = dt * G[0, i], dt * G[1, i], dt * G[2, i]
        for j in range(n):
            out[i, j] = P[i, j] - (a * P[end, j] + b * P[end + 1, j] + c * P[end + 2, j])
    for i in range(end, n):
        for j in range(n):
            out[i, j] = P[i, j]
    for i in range(3):
        a, b = (i + 1) % 3, (i + 2) % 3  # (g × x)ᵢ = g_a x_b - g_b x_a
        fall, rise = dt * gravity[a], dt * gravity[b]
        x, y, z = dt * R[i, 0], dt * R[i, 1], dt * R[i, 2]
        for j in range(n):
            out[3 + i, j] += fall * P[b, j] - rise * P[a, j]
            out[6 + i, j] += dt * P[3 + i, j]
            out[3 + i, j] -= x * P[end + 3, j] + y * P[end + 4, j] + z * P[end + 5, j]


@compiled(
    ROWS, ROWS, VECTOR, VECTOR, ROWS, VECTOR, ANY_VECTOR, ANY_VECTOR, NUMBER, VECTOR, ROWS_OUT, ROWS_OUT, ROWS_OUT
)  # fmt: skip
def propagate(
    R: Array, columns: Array, gyroscope_bias: Array, accelerometer_bias: Array, P: Array, gravity: Array,
    angular_velocity: Array, specific_force: Array, dt: float, noise: Array,
    R_out: Array, columns_out: Array, P_out: Array,
) -> None:  # fmt: skip
    """R ← R exp((ω - b_g) dt), v ← v + a dt, p ← p + v dt + ½ a dt², and P ← Φ (P + dt Ad_X Q Ad_Xᵀ) Φᵀ.

    Args:
        R: (3, 3).
        columns: v, p, d₁ … d_N, (3, 2 + N).
        gyroscope_bias: b_g, (3,).
        accelerometer_bias: b_a, (3,).
        P: (15 + 3 N, 15 + 3 N).
        gravity: (3,) in m/s².
        angular_velocity: (3,) in rad/s.
        specific_force: (3,) in m/s².
        dt: s.
        noise: densities of gyroscope, accelerometer, their biases, and contact, (5,).
        R_out: for the new R.
        columns_out: for the new columns.
        P_out: for the new P.
    """
    _require_state(R, columns, gyroscope_bias, accelerometer_bias, P)
    _require_state(R_out, columns_out, gyroscope_bias, accelerometer_bias, P_out)
    if not (columns.shape[1] == columns_out.shape[1] and len(gravity) == 3 and len(noise) == 5):
        raise ValueError("propagate: the new columns, gravity or noise have another size")
    if not (len(angular_velocity) == 3 and len(specific_force) == 3):
        raise ValueError("propagate: angular velocity or specific force has another size than 3")
    n = len(P)
    end = n - 6
    G = np.empty((3, end))  # what rotations of the IMU do to the error, transposed: R, and x × R for each column x
    for k in range(3):
        for i in range(3):
            G[k, i] = R[i, k]
        for c in range(columns.shape[1]):
            x, y, z = columns[0, c], columns[1, c], columns[2, c]
            G[k, 3 + 3 * c] = y * R[2, k] - z * R[1, k]
            G[k, 4 + 3 * c] = z * R[0, k] - x * R[2, k]
            G[k, 5 + 3 * c] = x * R[1, k] - y * R[0, k]
    driven, halfway = P.copy(), np.empty((n, n))
    density = dt * noise[0] ** 2
    for i in range(end):
        a, b, c = density * G[0, i], density * G[1, i], density * G[2, i]
        for j in range(end):
            driven[i, j] += a * G[0, j] + b * G[1, j] + c * G[2, j]
    for i in range(3, n):
        if not 6 <= i < 9:  # nothing drives the position but the velocity
            kind = 1 if i < 6 else 4 if i < end else 2 if i < end + 3 else 3
            driven[i, i] += dt * noise[kind] ** 2
    _carried(driven, G, R, gravity, dt, halfway)
    for i in range(n):
        for j in range(n):
            driven[i, j] = halfway[j, i]
    _carried(driven, G, R, gravity, dt, P_out)

    turn, axis, acceleration = np.empty(3), np.empty(3), gravity.copy()
    for i in range(3):
        turn[i] = (angular_velocity[i] - gyroscope_bias[i]) * dt
        for k in range(3):
            acceleration[i] += R[i, k] * (specific_force[k] - accelerometer_bias[k])
    a, b, _ = _coefficients(turn)
    for i in range(3):  # the rows of R exp(W) are exp(-W) of the rows of R
        for k in range(3):
            axis[k] = R[i, k]
        _turned(turn, -a, b, axis, R_out[i])
        for c in range(columns.shape[1]):
            columns_out[i, c] = columns[i, c]
        columns_out[i, 0] += acceleration[i] * dt
        columns_out[i, 1] += columns[i, 0] * dt + 0.5 * dt**2 * acceleration[i]


@part
def _innovation(
    R: Array, columns: Array, P: Array, points: np.ndarray, places: Array, covariance: Array, z: Array, S: Array
) -> None:  # fmt: skip
    """Write z = R y + p - d of points in contact, and S = H P Hᵀ + R C Rᵀ with H = [0 0 -1 … 1 …]."""
    half = np.empty((3, 3))
    for a in range(len(points)):
        row = 9 + 3 * points[a]
        for i in range(3):
            z[3 * a + i] = columns[i, 1] - columns[i, 2 + points[a]]
            for k in range(3):
                z[3 * a + i] += R[i, k] * places[a, k]
        for b in range(a, len(points)):
            column = 9 + 3 * points[b]
            for i in range(3):
                for j in range(3):
                    half[i, j] = 0.0
                    for k in range(3):
                        half[i, j] += R[i, k] * covariance[3 * a + k, 3 * b + j]
            for i in range(3):
                for j in range(3):
                    total = P[row + i, column + j] - P[row + i, 6 + j] - P[6 + i, column + j] + P[6 + i, 6 + j]
                    for k in range(3):
                        total += half[i, k] * R[j, k]
                    S[3 * a + i, 3 * b + j] = S[3 * b + j, 3 * a + i] = total


@part
def _square(z: Array, S: Array, start: int, end: int) -> float:
    """The product zᵀ S⁻¹ z of some rows, by the Cholesky factorization; -1 where S is not positive definite."""
    m = end - start
    U, y, total = S[start:end, start:end].copy(), z[start:end].copy(), 0.0
    for i in range(m):
        if U[i, i] <= 0.0:
            return -1.0
        total += y[i] * y[i] / U[i, i]
        for k in range(i + 1, m):
            share = U[i, k] / U[i, i]
            for j in range(k, m):
                U[k, j] -= share * U[i, j]
            y[k] -= share * y[i]
    return total


@compiled(
    ROWS, ROWS, VECTOR, VECTOR, ROWS, INDICES, INDICES, ROWS, ROWS, VECTOR, VECTOR_OUT, ROWS_OUT, ROWS_OUT, VECTOR_OUT,
    VECTOR_OUT, ROWS_OUT,
)  # fmt: skip
def correct(
    R: Array, columns: Array, gyroscope_bias: Array, accelerometer_bias: Array, P: Array, points: np.ndarray,
    ends: np.ndarray, places: Array, covariance: Array, limits: Array, squares: Array, R_out: Array,
    columns_out: Array, gyroscope_out: Array, accelerometer_out: Array, P_out: Array,
) -> int:  # fmt: skip
    """X ← exp(K z) X and P ← P - K H P, with K = P Hᵀ S⁻¹, unless what some contacts contradict by is too much.

    z = R y + p - d and S = H P Hᵀ + R C Rᵀ with H = [0 0 -1 … 1 …]. With S = UᵀU and Y = U⁻ᵀ H P, K z = Yᵀ U⁻ᵀ z and
    K H P = YᵀY.

    Args:
        R: (3, 3).
        columns: v, p, d₁ … d_N, (3, 2 + N).
        gyroscope_bias: b_g, (3,).
        accelerometer_bias: b_a, (3,).
        P: (15 + 3 N, 15 + 3 N).
        points: which of the d are seen, contact by contact, (k,).
        ends: after which of them those of each contact end, (c,).
        places: y, where they are seen from the IMU and in its axes, (k, 3) in m.
        covariance: C, of y, (3 k, 3 k) in m².
        limits: the largest zᵀ S⁻¹ z of each contact by itself, (c,).
        squares: for that of each, (c,).
        R_out: for the new R.
        columns_out: for the new columns.
        gyroscope_out: for the new b_g.
        accelerometer_out: for the new b_a.
        P_out: for the new P.

    Returns:
        1; 0 where a contact is beyond its limit, -1 where S is not positive definite. The new state is written for 1
        alone.
    """
    _require_state(R, columns, gyroscope_bias, accelerometer_bias, P)
    _require_state(R_out, columns_out, gyroscope_out, accelerometer_out, P_out)
    k, c = len(points), len(ends)
    if not (columns.shape[1] == columns_out.shape[1] and places.shape == (k, 3) and covariance.shape == (3 * k, 3 * k)):
        raise ValueError("correct: the new columns, places or covariance have another size than the points")
    if not (len(limits) == c and len(squares) == c and (c == 0 or ends[c - 1] <= k)):
        raise ValueError("correct: limits, squares or ends have another size than the contacts")
    for i in range(k):
        if not 0 <= points[i] < columns.shape[1] - 2:
            raise IndexError("correct: a point is not below the number of points of the filter")
    n, m = len(P), 3 * len(points)
    end = n - 6
    y, U, Y = np.empty(m), np.empty((m, m)), np.empty((m, n))
    _innovation(R, columns, P, points, places, covariance, y, U)
    start, within = 0, True
    for i in range(len(ends)):
        squares[i] = _square(y, U, 3 * start, 3 * ends[i])
        if squares[i] < 0.0:
            return -1
        within = within and squares[i] <= limits[i]
        start = ends[i]
    if not within:
        return 0
    for a in range(len(points)):
        for i in range(3):
            for j in range(n):
                Y[3 * a + i, j] = P[9 + 3 * points[a] + i, j] - P[6 + i, j]
    for i in range(m):
        if not U[i, i] > 0.0:  # NaN too
            return -1
        scale = 1.0 / math.sqrt(U[i, i])
        u, row = U[i], Y[i]
        for j in range(i, m):
            u[j] *= scale
        for j in range(n):
            row[j] *= scale
        y[i] *= scale
        for k in range(i + 1, m):
            share, u_below, below = u[k], U[k], Y[k]
            for j in range(k, m):
                u_below[j] -= share * u[j]
            for j in range(n):
                below[j] -= share * row[j]
            y[k] -= share * y[i]
    delta = np.zeros(n)
    for i in range(n):
        out = P_out[i]
        for j in range(n):
            out[j] = 0.5 * (P[i, j] + P[j, i])
        for k in range(m):
            share, row = Y[k, i], Y[k]
            delta[i] += share * y[k]
            for j in range(n):  # all of them, so that both halves are the same sums
                out[j] -= share * row[j]

    turn, before, after = delta[:3], np.empty(3), np.empty(3)
    sine, cosine, cube = _coefficients(turn)
    for column in range(3):
        for i in range(3):
            before[i] = R[i, column]
        _turned(turn, sine, cosine, before, after)
        for i in range(3):
            R_out[i, column] = after[i]
    for column in range(columns.shape[1]):
        for i in range(3):
            before[i] = columns[i, column]
        _turned(turn, sine, cosine, before, after)
        for i in range(3):
            columns_out[i, column] = after[i]
        _turned(turn, cosine, cube, delta[3 + 3 * column : 6 + 3 * column], after)
        for i in range(3):
            columns_out[i, column] += after[i]
    for i in range(3):
        gyroscope_out[i] = gyroscope_bias[i] + delta[end + i]
        accelerometer_out[i] = accelerometer_bias[i] + delta[end + 3 + i]
    return 1


compile_all()
