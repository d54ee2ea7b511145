"""The invariant filter's prediction and correction in NumPy, as matrices: what the compiled one is held against."""

import math

import numpy as np
import pinocchio as pin
from scipy.linalg.lapack import dposv

from wbc_controller.estimation.invariant_filter import InvariantFilter

_ROTATION, _VELOCITY, _POSITION, _POINTS = slice(0, 3), slice(3, 6), slice(6, 9), 9
_SMALL = 1.0e-6


class PlainFilter(InvariantFilter):
    def propagate(self, angular_velocity, specific_force, dt, creep):
        R, noise, end = self.rotation, self.noise, 9 + 3 * len(self.names)
        turned = exp3((angular_velocity - self.gyroscope_bias) * dt)
        acceleration = R @ (specific_force - self.accelerometer_bias) + self._gravity
        # The covariance first: its matrices are those of the state before (as in the authors' own code).
        Phi = np.eye(len(self.P))
        Phi[_VELOCITY, _ROTATION] = pin.skew(self._gravity) * dt
        Phi[_POSITION, _VELOCITY] = dt * np.eye(3)
        Phi[_ROTATION, end : end + 3] = -dt * R
        Phi[_VELOCITY, end + 3 : end + 6] = -dt * R
        # Ad_X: R on the diagonal, and (x ×) R beside it for each column x of X .
        lever = hats(self.columns.T) @ R
        Phi[3:end, end : end + 3] -= dt * lever.reshape(-1, 3)
        adjoint = np.zeros((len(self.P), len(self.P) - 3))
        adjoint[_ROTATION, :3] = R * noise.gyroscope
        adjoint[3:end, :3] = lever.reshape(-1, 3) * noise.gyroscope
        adjoint[_VELOCITY, 3:6] = R * noise.accelerometer
        for i in range(len(self.names)):
            adjoint[_POINTS + 3 * i : _POINTS + 3 * i + 3, 6 + 3 * i : 9 + 3 * i] = R * creep[i]
        adjoint[end:, -6:] = np.diag(np.repeat([noise.gyroscope_bias, noise.accelerometer_bias], 3))
        driven = Phi @ adjoint
        self.P = Phi @ self.P @ Phi.T + dt * (driven @ driven.T)
        self.columns[:, 1] += self.velocity * dt + 0.5 * dt**2 * acceleration
        self.columns[:, 0] += acceleration * dt
        self.rotation = R @ turned

    def innovation(self, names, places, covariance):
        at, k, R = [self.names.index(name) for name in names], len(names), self.rotation
        z = (R @ places.T + self.position[:, None] - self.columns[:, 2:][:, at]).T.reshape(-1)
        # H P Hᵀ + R covariance Rᵀ, block by block
        rows = self._rows(names)
        S = self.P[rows][:, rows]
        beside = np.tile(self.P[rows, _POSITION], k)
        S -= beside
        S -= beside.T
        S += np.tile(self.P[_POSITION, _POSITION], (k, k))
        turned = R @ covariance.reshape(k, 3, 3 * k)
        turned = (turned.reshape(3 * k, k, 3) @ R.T).reshape(3 * k, 3 * k)
        return z, S + turned

    def correct(self, names, z, S):
        if not names:
            return
        # H = [0 0 -I … I …]: P Hᵀ are differences of columns of P.
        PHt = self.P[:, self._rows(names)] - np.tile(self.P[:, _POSITION], len(names))
        _, solved, info = dposv(S, PHt.T)
        if info != 0:
            raise np.linalg.LinAlgError("the covariance of the innovation is not positive definite")
        self._apply(z @ solved)
        self.P = self.P - PHt @ solved
        self.P = 0.5 * (self.P + self.P.T)

    def _rows(self, names):
        return np.concatenate([_POINTS + 3 * self.names.index(name) + np.arange(3) for name in names])

    def _apply(self, delta):
        """X ← exp(δ) X, θ ← θ + δ_θ."""
        turn, end = delta[:3], 9 + 3 * len(self.names)
        R, V = exp3(turn), left_jacobian3(turn)
        self.rotation = R @ self.rotation
        self.columns = R @ self.columns + V @ delta[3:end].reshape(-1, 3).T
        self.gyroscope_bias = self.gyroscope_bias + delta[end : end + 3]
        self.accelerometer_bias = self.accelerometer_bias + delta[end + 3 :]


def hats(vectors):
    """The matrix x × of each vector x, (k, 3) to (k, 3, 3)."""
    found = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    found[:, 0, 1], found[:, 0, 2], found[:, 1, 2] = -z, y, -x
    found[:, 1, 0], found[:, 2, 0], found[:, 2, 1] = z, -y, x
    return found


def exp3(w):
    """Exponential map of SO(3), (3, 3): the rotation by |w| about w."""
    a, b, _ = _coefficients(w)
    W = pin.skew(w)
    return np.eye(3) + a * W + b * (W @ W)


def left_jacobian3(w):
    """Left Jacobian of SO(3), (3, 3)."""
    _, b, c = _coefficients(w)
    W = pin.skew(w)
    return np.eye(3) + b * W + c * (W @ W)


def _coefficients(w):
    """The series sin θ / θ, (1 - cos θ) / θ² and (θ - sin θ) / θ³."""
    angle = math.sqrt(float(w @ w))
    if angle < _SMALL:
        return 1.0, 0.5, 1.0 / 6.0
    return (math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle**2, (angle - math.sin(angle)) / angle**3)
