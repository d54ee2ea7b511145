"""Kernels of `estimation.invariant_filter`: propagation and correction."""

import math

import numpy as np

from wbc_controller.compilation import Indices, Matrix, StridedVector, Vector, compiled, copy_rows, part
from wbc_controller.inverse_dynamics.robot.placement_kernels import (
    Vector3,
    add,
    cross,
    dot,
    put,
    scale,
    subtract,
    three,
)
from wbc_controller.records import Array

_SMALL = 1.0e-6  # angle below which quotients are replaced by series, rad


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
def _add_noise(P: Array, G: Array, dt: float, noise: Array, creep: Array) -> None:
    n, end, density = len(P), G.shape[1], dt * noise[0] ** 2
    for i in range(end):
        for j in range(end):
            for k in range(3):
                P[i, j] += density * G[k, i] * G[k, j]
    for i in range(3, n):
        if not 6 <= i < 9:  # the position has no noise of its own
            own = noise[1] if i < 6 else creep[i // 3 - 3] if i < end else noise[2] if i < end + 3 else noise[3]
            P[i, i] += dt * own**2


@part
def _transition(P: Array, G: Array, R: Array, gravity: Array, dt: float, out: Array) -> None:
    """Write Φ P with Φ = 1 + A dt."""
    n, end = len(P), G.shape[1]
    copy_rows(P, out)
    for i in range(end):
        for j in range(n):
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
    R: Matrix, columns: Matrix, gyroscope_bias: Vector, accelerometer_bias: Vector, P: Matrix, gravity: Vector,
    angular_velocity: StridedVector, specific_force: StridedVector, dt: float, noise: Vector, creep: Vector,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Return R exp((ω - b_g) dt), v + a dt, p + v dt + ½ a dt², and Φ (P + dt Ad_X Q Ad_Xᵀ) Φᵀ.

    The state (R, columns, biases, P) is that of `InvariantFilter`; `noise` are its first four densities in their
    order, and `creep` those of the points, (N,).
    """
    _require_state(R, columns, gyroscope_bias, accelerometer_bias, P)
    if not (len(gravity) == 3 and len(noise) == 4 and len(angular_velocity) == 3 and len(specific_force) == 3):
        raise ValueError("propagate: wrong size of gravity, noise, angular_velocity or specific_force")
    if len(creep) != columns.shape[1] - 2:
        raise ValueError("propagate: wrong size of creep")
    G, noisy, halfway = _rotation_errors(R, columns), P.copy(), np.empty(P.shape)
    _add_noise(noisy, G, dt, noise, creep)
    _transition(noisy, G, R, gravity, dt, halfway)
    _transition(halfway.T, G, R, gravity, dt, noisy)

    w = scale(dt, subtract(three(angular_velocity, 0), three(gyroscope_bias, 0)))
    a, b, _ = _series(w)
    turned, moved = np.empty((3, 3)), columns.copy()
    for i in range(3):
        put(turned[i], 0, _turned(w, -a, b, three(R[i], 0)))  # rows of R exp(W) = exp(-W) of the rows of R
        acceleration = gravity[i]
        for k in range(3):
            acceleration += R[i, k] * (specific_force[k] - accelerometer_bias[k])
        moved[i, 0] += acceleration * dt
        moved[i, 1] += columns[i, 0] * dt + 0.5 * dt**2 * acceleration
    return turned, moved, noisy


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
def _reduce(U: Array, Y: Array, y: Array) -> None:
    """Factorize S = UᵀU in place; write U⁻ᵀ Y and U⁻ᵀ y; raise LinAlgError if S is not positive definite."""
    m, n = Y.shape
    for i in range(m):
        if U[i, i] <= 0.0:  # NaN spreads
            raise np.linalg.LinAlgError("the covariance of the innovation is not positive definite")
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


@compiled
def correct(
    R: Matrix, columns: Matrix, gyroscope_bias: Vector, accelerometer_bias: Vector, P: Matrix, points: Indices,
    ends: Indices, positions: Matrix, covariance: Matrix,
) -> tuple[Array, Array, Array, Array, Array, Array]:  # fmt: skip
    """Return zᵀ S⁻¹ z of each group of points, (c,), and the corrected state: exp(K z) X, biases, P - K H P.

    With K = P Hᵀ S⁻¹, S = UᵀU and Y = U⁻ᵀ H P, K z = Yᵀ U⁻ᵀ z and K H P = YᵀY. Arguments as for
    `InvariantFilter.correct`, with indices of points, (k,).
    """
    _require_state(R, columns, gyroscope_bias, accelerometer_bias, P)
    n, k, m = len(P), len(points), 3 * len(points)
    if not (positions.shape == (k, 3) and covariance.shape == (m, m) and (len(ends) == 0 or ends[-1] <= k)):
        raise ValueError("correct: positions, covariance and ends must match the points")
    for i in range(k):
        if not 0 <= points[i] < columns.shape[1] - 2:
            raise IndexError("correct: a point index exceeds the points of the filter")
    y, U, Y, delta = np.empty(m), np.empty((m, m)), np.empty((m, n)), np.zeros(n)
    _innovation(R, columns, P, points, positions, covariance, y, U)
    start, squares = 0, np.empty(len(ends))
    for i in range(len(ends)):
        own = slice(3 * start, 3 * ends[i])
        alone = y[own].copy()
        _reduce(U[own, own].copy(), np.empty((len(alone), 0)), alone)
        squares[i] = 0.0
        for value in alone:
            squares[i] += value * value
        start = ends[i]
    for a in range(k):
        for i in range(3):
            for j in range(n):
                Y[3 * a + i, j] = P[9 + 3 * points[a] + i, j] - P[6 + i, j]  # H P
    _reduce(U, Y, y)
    reduced = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            reduced[i, j] = 0.5 * (P[i, j] + P[j, i])  # symmetric
        for r in range(m):
            delta[i] += Y[r, i] * y[r]
            for j in range(n):
                reduced[i, j] -= Y[r, i] * Y[r, j]

    w = three(delta, 0)  # exp(ξ) X for ξ = (ξ_R, ξ_v, ξ_p, …)
    sine, cosine, cube = _series(w)
    turned, moved = np.empty((3, 3)), np.empty(columns.shape)
    for i in range(3):
        put(turned.T[i], 0, _turned(w, sine, cosine, three(R.T[i], 0)))
    for i in range(columns.shape[1]):
        shift = _turned(w, cosine, cube, three(delta, 3 + 3 * i))
        put(moved.T[i], 0, add(_turned(w, sine, cosine, three(columns.T[i], 0)), shift))
    gyroscope, accelerometer = gyroscope_bias.copy(), accelerometer_bias.copy()
    for i in range(3):
        gyroscope[i] += delta[n - 6 + i]
        accelerometer[i] += delta[n - 3 + i]
    return squares, turned, moved, gyroscope, accelerometer, reduced
