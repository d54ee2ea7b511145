"""The invariant filter's prediction and correction in NumPy, as matrices: what the compiled one is held against."""

import numpy as np
import pinocchio as pin
from scipy import linalg

from wbc_controller.estimation.invariant_filter import InvariantFilter

_ROTATION, _VELOCITY, _POSITION, _POINTS = slice(0, 3), slice(3, 6), slice(6, 9), 9


class PlainFilter(InvariantFilter):
    def propagate(self, angular_velocity, specific_force, dt, creep):
        R, noise, end = self.rotation, self.settings, 9 + 3 * len(self.names)
        turned = pin.exp3((angular_velocity - self.gyroscope_bias) * dt)
        acceleration = R @ (specific_force - self.accelerometer_bias) + self._gravity
        # The covariance first: its matrices are those of the state before (as in the authors' own code).
        Phi = np.eye(len(self.P))
        Phi[_VELOCITY, _ROTATION] = pin.skew(self._gravity) * dt
        Phi[_POSITION, _VELOCITY] = dt * np.eye(3)
        Phi[_ROTATION, end : end + 3] = -dt * R
        Phi[_VELOCITY, end + 3 : end + 6] = -dt * R
        # Ad_X: R on the diagonal, and (x ×) R beside it for each column x of X .
        lever = np.array([pin.skew(column) for column in self.columns.T]) @ R
        Phi[3:end, end : end + 3] -= dt * lever.reshape(-1, 3)
        adjoint = np.zeros((len(self.P), len(self.P) - 3))
        adjoint[_ROTATION, :3] = R * noise.gyroscope_noise
        adjoint[3:end, :3] = lever.reshape(-1, 3) * noise.gyroscope_noise
        adjoint[_VELOCITY, 3:6] = R * noise.accelerometer_noise
        for i in range(len(self.names)):
            adjoint[_POINTS + 3 * i : _POINTS + 3 * i + 3, 6 + 3 * i : 9 + 3 * i] = R * creep[i]
        adjoint[end:, -6:] = np.diag(np.repeat([noise.gyroscope_bias_walk, noise.accelerometer_bias_walk], 3))
        driven = Phi @ adjoint
        self.P = Phi @ self.P @ Phi.T + dt * (driven @ driven.T)
        self.columns[:, 1] += self.velocity * dt + 0.5 * dt**2 * acceleration
        self.columns[:, 0] += acceleration * dt
        self.rotation = R @ turned

    def innovation(self, names, places, covariance):
        at, R, H = [self.names.index(name) for name in names], self.rotation, self._jacobian(names)
        z = (R @ places.T + self.position[:, None] - self.columns[:, 2:][:, at]).T.reshape(-1)
        turn = np.kron(np.eye(len(names)), R)
        return z, H @ self.P @ H.T + turn @ covariance @ turn.T

    def correct(self, names, z, S):
        if not names:
            return
        H = self._jacobian(names)
        solved = linalg.solve(S, H @ self.P, assume_a="pos")
        self._apply(z @ solved)
        self.P = self.P - self.P @ H.T @ solved
        self.P = 0.5 * (self.P + self.P.T)

    def _jacobian(self, names):
        """Return H = [0 0 -I … I …], (3 k, n)."""
        H = np.zeros((3 * len(names), len(self.P)))
        for i, name in enumerate(names):
            point = _POINTS + 3 * self.names.index(name)
            H[3 * i : 3 * i + 3, _POSITION], H[3 * i : 3 * i + 3, point : point + 3] = -np.eye(3), np.eye(3)
        return H

    def _apply(self, delta):
        """X ← exp(δ) X, θ ← θ + δ_θ."""
        turn, end = delta[:3], 9 + 3 * len(self.names)
        R, V = pin.exp3(turn), pin.Jexp3(-turn)  # the left Jacobian is the right one of -δ
        self.rotation = R @ self.rotation
        self.columns = R @ self.columns + V @ delta[3:end].reshape(-1, 3).T
        self.gyroscope_bias = self.gyroscope_bias + delta[end : end + 3]
        self.accelerometer_bias = self.accelerometer_bias + delta[end + 3 :]
