"""Prediction and correction of the invariant filter (`estimation.invariant_filter`, which has the symbols)."""

from __future__ import annotations

import math

import numpy as np

from wbc_controller.kernels.compiled import (
    ANY_MATRIX,
    ANY_VECTOR,
    INDICES,
    NUMBER,
    ROWS_OUT,
    VECTOR_OUT,
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
def _carried(P: Array, G: Array, R: Array, gravity: Array, dt: float, out: Array) -> None:
    """Φ P, with Φ = 1 + A dt: its few blocks beside the diagonal, row by row."""
    n, end = len(P), len(G)
    for i in range(n):
        for j in range(n):
            out[i, j] = P[i, j]
    for i in range(end):
        for k in range(3):
            share = dt * G[i, k]
            for j in range(n):
                out[i, j] -= share * P[end + k, j]
    for i in range(3):
        a, b = (i + 1) % 3, (i + 2) % 3  # (g × x)ᵢ = g_a x_b - g_b x_a
        for j in range(n):
            out[3 + i, j] += dt * (gravity[a] * P[b, j] - gravity[b] * P[a, j])
            out[6 + i, j] += dt * P[3 + i, j]
        for k in range(3):
            share = dt * R[i, k]
            for j in range(n):
                out[3 + i, j] -= share * P[end + 3 + k, j]


@compiled(
    ANY_MATRIX,
    ANY_MATRIX,
    ANY_VECTOR,
    ANY_VECTOR,
    ANY_MATRIX,
    ANY_VECTOR,
    ANY_VECTOR,
    ANY_VECTOR,
    NUMBER,
    ANY_VECTOR,
    ROWS_OUT,
    ROWS_OUT,
    ROWS_OUT,
)
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
    n = len(P)
    end = n - 6
    G = np.empty((end, 3))  # what rotations of the IMU do to the error: R, and x × R for each column x
    for k in range(3):
        for i in range(3):
            G[i, k] = R[i, k]
        for c in range(columns.shape[1]):
            x, y, z = columns[0, c], columns[1, c], columns[2, c]
            G[3 + 3 * c, k] = y * R[2, k] - z * R[1, k]
            G[4 + 3 * c, k] = z * R[0, k] - x * R[2, k]
            G[5 + 3 * c, k] = x * R[1, k] - y * R[0, k]
    driven, halfway = P.copy(), np.empty((n, n))
    density = dt * noise[0] ** 2
    for i in range(end):
        for j in range(end):
            driven[i, j] += density * (G[i, 0] * G[j, 0] + G[i, 1] * G[j, 1] + G[i, 2] * G[j, 2])
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


@compiled(ANY_MATRIX, ANY_MATRIX, ANY_MATRIX, INDICES, ANY_MATRIX, ANY_MATRIX, VECTOR_OUT, ROWS_OUT)
def innovation(
    R: Array, columns: Array, P: Array, points: np.ndarray, places: Array, covariance: Array, z: Array, S: Array
) -> None:  # fmt: skip
    """Compute z = R y + p - d of points in contact, and S = H P Hᵀ + R C Rᵀ with H = [0 0 -1 … 1 …].

    Args:
        R: (3, 3).
        columns: v, p, d₁ … d_N, (3, 2 + N).
        P: (15 + 3 N, 15 + 3 N).
        points: which of the d, (k,).
        places: y, (k, 3) in m.
        covariance: C, (3 k, 3 k) in m².
        z: for z, (3 k,).
        S: for S, (3 k, 3 k).
    """
    half = np.empty((3, 3))
    for a in range(len(points)):
        row = 9 + 3 * points[a]
        for i in range(3):
            z[3 * a + i] = columns[i, 1] - columns[i, 2 + points[a]]
            for k in range(3):
                z[3 * a + i] += R[i, k] * places[a, k]
        for b in range(len(points)):
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
                    S[3 * a + i, 3 * b + j] = total


@compiled(
    ANY_MATRIX,
    ANY_MATRIX,
    ANY_VECTOR,
    ANY_VECTOR,
    ANY_MATRIX,
    INDICES,
    ANY_VECTOR,
    ANY_MATRIX,
    ROWS_OUT,
    ROWS_OUT,
    VECTOR_OUT,
    VECTOR_OUT,
    ROWS_OUT,
)
def correct(
    R: Array, columns: Array, gyroscope_bias: Array, accelerometer_bias: Array, P: Array, points: np.ndarray, z: Array,
    S: Array, R_out: Array, columns_out: Array, gyroscope_out: Array, accelerometer_out: Array, P_out: Array,
) -> bool:  # fmt: skip
    """X ← exp(K z) X and P ← P - K H P, with K = P Hᵀ S⁻¹.

    With S = UᵀU and Y = U⁻ᵀ H P, K z = Yᵀ U⁻ᵀ z and K H P = YᵀY.

    Args:
        R: (3, 3).
        columns: v, p, d₁ … d_N, (3, 2 + N).
        gyroscope_bias: b_g, (3,).
        accelerometer_bias: b_a, (3,).
        P: (15 + 3 N, 15 + 3 N).
        points: which of the d the innovation is of, (k,).
        z: the innovation, (3 k,).
        S: its covariance, (3 k, 3 k).
        R_out: for the new R.
        columns_out: for the new columns.
        gyroscope_out: for the new b_g.
        accelerometer_out: for the new b_a.
        P_out: for the new P.

    Returns:
        Whether S is positive definite; nothing is written otherwise.
    """
    n, m = len(P), len(z)
    end = n - 6
    U, Y, y = S.copy(), np.empty((m, n)), z.copy()
    for a in range(len(points)):
        for i in range(3):
            for j in range(n):
                Y[3 * a + i, j] = P[9 + 3 * points[a] + i, j] - P[6 + i, j]
    for i in range(m):
        if not U[i, i] > 0.0:  # NaN too
            return False
        root = math.sqrt(U[i, i])
        for j in range(i, m):
            U[i, j] /= root
        for j in range(n):
            Y[i, j] /= root
        y[i] /= root
        for k in range(i + 1, m):
            share = U[i, k]
            for j in range(k, m):
                U[k, j] -= share * U[i, j]
            for j in range(n):
                Y[k, j] -= share * Y[i, j]
            y[k] -= share * y[i]
    delta = np.zeros(n)
    for i in range(n):
        for j in range(i, n):
            P_out[i, j] = 0.5 * (P[i, j] + P[j, i])
    for k in range(m):
        for i in range(n):
            share = Y[k, i]
            delta[i] += share * y[k]
            for j in range(i, n):
                P_out[i, j] -= share * Y[k, j]
    for i in range(n):
        for j in range(i):
            P_out[i, j] = P_out[j, i]

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
    return True
