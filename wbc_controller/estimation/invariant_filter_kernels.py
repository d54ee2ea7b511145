"""Kernels of `estimation.invariant_filter`: propagation and correction."""

from __future__ import annotations

import math

import numpy as np

from wbc_controller.compilation import Indices, Matrix, OutMatrix, OutVector, StridedVector, Vector, compiled, part
from wbc_controller.inverse_dynamics.robot.placement_kernels import Vector3, add, cross, dot, put, scale, three
from wbc_controller.records import Array

#: Angle below which quotients are replaced by series, rad.
_SMALL = 1.0e-6


@part
def _series(w: Vector3) -> Vector3:
    """Return sin θ / θ, (1 - cos θ) / θ² and (θ - sin θ) / θ³ of θ = |w|."""
    angle = math.sqrt(dot(w, w))
    if angle < _SMALL:
        return 1.0, 0.5, 1.0 / 6.0
    return math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle**2, (angle - math.sin(angle)) / angle**3


@part
def _turned(w: Vector3, a: float, b: float, x: Vector3) -> Vector3:
    """Return (1 + a W + b W²) x with W = w ×; exp(W) x for a = sin θ / θ and b = (1 - cos θ) / θ²."""
    once = cross(w, x)
    return add(x, add(scale(a, once), scale(b, cross(w, once))))


@part
def _require_state(R: Array, columns: Array, gyroscope_bias: Array, accelerometer_bias: Array, P: Array) -> None:
    size = 9 + 3 * columns.shape[1]
    if not (R.shape == (3, 3) and columns.shape[0] == 3 and columns.shape[1] >= 2 and P.shape == (size, size)):
        raise ValueError("invariant filter: the sizes of R, columns and P do not agree")
    if not (len(gyroscope_bias) == 3 and len(accelerometer_bias) == 3):
        raise ValueError("invariant filter: a bias must have size 3")


@part
def _rotation_errors(R: Array, columns: Array) -> Array:
    """Return the transposed errors of rotations: R, and x × R of each column x, (3, 3 + 3 (2 + N))."""
    G = np.empty((3, 3 + 3 * columns.shape[1]))
    for k in range(3):
        axis = R[0, k], R[1, k], R[2, k]
        put(G[k], 0, axis)
        for c in range(columns.shape[1]):
            put(G[k], 3 + 3 * c, cross((columns[0, c], columns[1, c], columns[2, c]), axis))
    return G


@part
def _add_noise(P: Array, G: Array, dt: float, noise: Array) -> None:
    n, end, density = len(P), G.shape[1], dt * noise[0] ** 2
    for i in range(end):
        for j in range(end):
            for k in range(3):
                P[i, j] += density * G[k, i] * G[k, j]
    for i in range(3, n):
        if not 6 <= i < 9:  # the position has no noise of its own
            kind = 1 if i < 6 else 4 if i < end else 2 if i < end + 3 else 3
            P[i, i] += dt * noise[kind] ** 2


@part
def _transition(P: Array, G: Array, R: Array, gravity: Array, dt: float, out: Array) -> None:
    """Write Φ P with Φ = 1 + A dt."""
    n, end = len(P), G.shape[1]
    for i in range(n):
        for j in range(n):
            out[i, j] = P[i, j]
            if i < end:
                for k in range(3):
                    out[i, j] -= dt * G[k, i] * P[end + k, j]
    for i in range(3):
        a, b = (i + 1) % 3, (i + 2) % 3  # (g × x)ᵢ = g_a x_b - g_b x_a
        for j in range(n):
            out[3 + i, j] += dt * (gravity[a] * P[b, j] - gravity[b] * P[a, j])
            out[6 + i, j] += dt * P[3 + i, j]
            for k in range(3):
                out[3 + i, j] -= dt * R[i, k] * P[end + 3 + k, j]


@compiled
def propagate(
    R: Matrix,
    columns: Matrix,
    gyroscope_bias: Vector,
    accelerometer_bias: Vector,
    P: Matrix,
    gravity: Vector,
    angular_velocity: StridedVector,
    specific_force: StridedVector,
    dt: float,
    noise: Vector,
    R_out: OutMatrix,
    columns_out: OutMatrix,
    P_out: OutMatrix,
) -> None:
    """Write R exp((ω - b_g) dt), v + a dt, p + v dt + ½ a dt², and Φ (P + dt Ad_X Q Ad_Xᵀ) Φᵀ.

    The state (R, columns, biases, P) is that of `InvariantFilter`; `noise` are its densities in their order, (5,).
    """
    _require_state(R, columns, gyroscope_bias, accelerometer_bias, P)
    _require_state(R_out, columns_out, gyroscope_bias, accelerometer_bias, P_out)
    if not (columns.shape[1] == columns_out.shape[1] and len(gravity) == 3 and len(noise) == 5):
        raise ValueError("propagate: wrong size of columns_out, gravity or noise")
    if not (len(angular_velocity) == 3 and len(specific_force) == 3):
        raise ValueError("propagate: angular_velocity and specific_force must have size 3")
    G, halfway = _rotation_errors(R, columns), P.copy()
    _add_noise(halfway, G, dt, noise)
    _transition(halfway, G, R, gravity, dt, P_out)
    for i in range(len(P)):
        for j in range(len(P)):
            halfway[i, j] = P_out[j, i]
    _transition(halfway, G, R, gravity, dt, P_out)

    w = (
        (angular_velocity[0] - gyroscope_bias[0]) * dt,
        (angular_velocity[1] - gyroscope_bias[1]) * dt,
        (angular_velocity[2] - gyroscope_bias[2]) * dt,
    )
    a, b, _ = _series(w)
    for i in range(3):
        put(R_out[i], 0, _turned(w, -a, b, three(R[i], 0)))  # rows of R exp(W) = exp(-W) of the rows of R
        acceleration = gravity[i]
        for k in range(3):
            acceleration += R[i, k] * (specific_force[k] - accelerometer_bias[k])
        for c in range(columns.shape[1]):
            columns_out[i, c] = columns[i, c]
        columns_out[i, 0] += acceleration * dt
        columns_out[i, 1] += columns[i, 0] * dt + 0.5 * dt**2 * acceleration


@part
def _innovation(
    R: Array, columns: Array, P: Array, points: Indices, positions: Array, covariance: Array, z: Array, S: Array
) -> None:
    """Write z = R y + p - d, and S = H P Hᵀ + R C Rᵀ with H = [0 0 -1 … 1 …]."""
    for a in range(len(points)):
        row = 9 + 3 * points[a]
        for i in range(3):
            z[3 * a + i] = columns[i, 1] - columns[i, 2 + points[a]] + dot(three(R[i], 0), three(positions[a], 0))
        for b in range(a, len(points)):
            column = 9 + 3 * points[b]
            for i in range(3):
                for j in range(3):
                    total = P[row + i, column + j] - P[row + i, 6 + j] - P[6 + i, column + j] + P[6 + i, 6 + j]
                    for k in range(3):
                        total += R[i, k] * dot(three(covariance[3 * a + k], 3 * b), three(R[j], 0))
                    S[3 * a + i, 3 * b + j] = S[3 * b + j, 3 * a + i] = total


@part
def _square(z: Array, S: Array, start: int, end: int) -> float:
    """Return zᵀ S⁻¹ z of some rows; -1 if S is not positive definite."""
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


@part
def _reduce(U: Array, Y: Array, y: Array) -> bool:
    """Factorize S = UᵀU in place; write U⁻ᵀ Y and U⁻ᵀ y; return False if S is not positive definite."""
    m, n = Y.shape
    for i in range(m):
        if not U[i, i] > 0.0:
            return False
        factor = 1.0 / math.sqrt(U[i, i])
        for j in range(i, m):
            U[i, j] *= factor
        for j in range(n):
            Y[i, j] *= factor
        y[i] *= factor
        for k in range(i + 1, m):
            share = U[i, k]
            for j in range(k, m):
                U[k, j] -= share * U[i, j]
            for j in range(n):
                Y[k, j] -= share * Y[i, j]
            y[k] -= share * y[i]
    return True


@part
def _retract(delta: Array, R: Array, columns: Array, R_out: Array, columns_out: Array) -> None:
    """Write exp(ξ) X for ξ = (ξ_R, ξ_v, ξ_p, …)."""
    w = three(delta, 0)
    sine, cosine, cube = _series(w)
    for c in range(3):
        column = _turned(w, sine, cosine, (R[0, c], R[1, c], R[2, c]))
        for i in range(3):
            R_out[i, c] = column[i]
    for c in range(columns.shape[1]):
        moved = _turned(w, sine, cosine, (columns[0, c], columns[1, c], columns[2, c]))
        moved = add(moved, _turned(w, cosine, cube, three(delta, 3 + 3 * c)))
        for i in range(3):
            columns_out[i, c] = moved[i]


@compiled
def correct(
    R: Matrix,
    columns: Matrix,
    gyroscope_bias: Vector,
    accelerometer_bias: Vector,
    P: Matrix,
    points: Indices,
    ends: Indices,
    positions: Matrix,
    covariance: Matrix,
    limits: Vector,
    squares: OutVector,
    R_out: OutMatrix,
    columns_out: OutMatrix,
    gyroscope_out: OutVector,
    accelerometer_out: OutVector,
    P_out: OutMatrix,
) -> int:
    """Write exp(K z) X and P - K H P with K = P Hᵀ S⁻¹, unless a contact exceeds its limit.

    With S = UᵀU and Y = U⁻ᵀ H P, K z = Yᵀ U⁻ᵀ z and K H P = YᵀY. Arguments as for `InvariantFilter.correct`, with
    indices of points, (k,); `squares` is an output. Returns 1 if the state is written, 0 if a square exceeds its limit,
    -1 if S is not positive definite.
    """
    _require_state(R, columns, gyroscope_bias, accelerometer_bias, P)
    _require_state(R_out, columns_out, gyroscope_out, accelerometer_out, P_out)
    k, c = len(points), len(ends)
    if not (
        columns.shape[1] == columns_out.shape[1] and positions.shape == (k, 3) and covariance.shape == (3 * k, 3 * k)
    ):
        raise ValueError("correct: columns_out, positions and covariance must match the points")
    if not (len(limits) == c and len(squares) == c and (c == 0 or ends[c - 1] <= k)):
        raise ValueError("correct: limits, squares and ends must match the contacts")
    for i in range(k):
        if not 0 <= points[i] < columns.shape[1] - 2:
            raise IndexError("correct: a point index exceeds the points of the filter")
    n, m = len(P), 3 * k
    y, U, Y, delta = np.empty(m), np.empty((m, m)), np.empty((m, n)), np.zeros(n)
    _innovation(R, columns, P, points, positions, covariance, y, U)
    start, within = 0, True
    for i in range(c):
        squares[i] = _square(y, U, 3 * start, 3 * ends[i])
        if squares[i] < 0.0:
            return -1
        within = within and squares[i] <= limits[i]
        start = ends[i]
    if not within:
        return 0
    for a in range(k):
        for i in range(3):
            for j in range(n):
                Y[3 * a + i, j] = P[9 + 3 * points[a] + i, j] - P[6 + i, j]  # H P
    if not _reduce(U, Y, y):
        return -1
    for i in range(n):
        for j in range(n):  # both halves, so that P stays symmetric
            P_out[i, j] = 0.5 * (P[i, j] + P[j, i])
        for r in range(m):
            delta[i] += Y[r, i] * y[r]
            for j in range(n):
                P_out[i, j] -= Y[r, i] * Y[r, j]
    _retract(delta, R, columns, R_out, columns_out)
    for i in range(3):
        gyroscope_out[i] = gyroscope_bias[i] + delta[n - 6 + i]
        accelerometer_out[i] = accelerometer_bias[i] + delta[n - 3 + i]
    return 1
