"""The contact-aided right-invariant extended Kalman filter.

After Hartley, Jadidi, Grizzle and Eustice, "Contact-aided invariant extended Kalman filtering for robot state
estimation" (International Journal of Robotics Research, 2020), its world-centric right-invariant filter.

The state is X ∈ SE_{N+2}(3) with the orientation R of the IMU, its velocity v and position p, and the positions dᵢ of
points in contact, all in the world, together with the biases b of gyroscope and accelerometer:

        | R  v  p  d₁ … d_N |
    X = | 0       I         |,    θ = (b_g, b_a)

The error is right-invariant, X̂ X⁻¹ = exp(ξ): its dynamics do not depend on the state but for the biases, so that the
filter converges from far off, and never takes yaw and position, which nothing observes, for observed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dposv

from wbc_controller.records import Array

#: Rows of the covariance that are always there: rotation, velocity, position.
_ROTATION, _VELOCITY, _POSITION = slice(0, 3), slice(3, 6), slice(6, 9)
#: First row of the covariance of the first contact point.
_POINTS = 9
#: Angle below which series take the place of quotients, rad.
_SMALL = 1.0e-6


@dataclass(frozen=True, slots=True)
class ImuNoise:
    """Noise of the IMU, and of contact points, as densities of white noise, each isotropic.

    Attributes:
        gyroscope: rad/s/√Hz.
        accelerometer: m/s²/√Hz.
        gyroscope_bias: of the gyroscope's bias walk, rad/s²/√Hz.
        accelerometer_bias: of the accelerometer's bias walk, m/s³/√Hz.
        contact: velocity of a point in contact, m/s/√Hz.
    """

    gyroscope: float
    accelerometer: float
    gyroscope_bias: float
    accelerometer_bias: float
    contact: float


class InvariantFilter:
    """Right-invariant extended Kalman filter of an IMU and points in contact.

    Attributes:
        rotation: R, (3, 3), from the IMU's axes to the world.
        columns: v, p, d₁ … d_N in the world, (3, 2 + N) in m/s and m.
        gyroscope_bias: b_g, (3,) in rad/s.
        accelerometer_bias: b_a, (3,) in m/s².
        P: covariance of (ξ_R, ξ_v, ξ_p, ξ_d₁ …, b_g, b_a), (15 + 3 N, 15 + 3 N).
        names: names of the points, in order.
    """

    def __init__(
        self,
        noise: ImuNoise,
        gravity: Array,
        *,
        rotation: Array,
        velocity: Array,
        position: Array,
        gyroscope_bias: Array,
        accelerometer_bias: Array,
        P: Array,
    ) -> None:
        """Begin without contact points.

        Args:
            noise: of the IMU and of contact points.
            gravity: (3,) in m/s², in the world.
            rotation: R, (3, 3).
            velocity: v, (3,) in m/s.
            position: p, (3,) in m.
            gyroscope_bias: (3,) in rad/s.
            accelerometer_bias: (3,) in m/s².
            P: covariance, (15, 15).
        """
        self.noise = noise
        self._gravity = np.array(gravity)
        self.rotation = np.array(rotation)
        self.columns = np.column_stack([velocity, position])
        self.gyroscope_bias = np.array(gyroscope_bias)
        self.accelerometer_bias = np.array(accelerometer_bias)
        self.P = np.array(P)
        self.names: list[str] = []

    @property
    def velocity(self) -> Array:
        """v, (3,) in m/s."""
        return self.columns[:, 0]

    @property
    def position(self) -> Array:
        """p, (3,) in m."""
        return self.columns[:, 1]

    def point(self, name: str) -> Array:
        """Position of a contact point in the world, (3,) in m."""
        return self.columns[:, 2 + self.names.index(name)]

    def propagate(self, angular_velocity: Array, specific_force: Array, dt: float) -> None:
        """Predict the state after a time: strapdown integration, and the linear error dynamics.

        Ṙ = R (ω - b_g)ₓ, v̇ = R (a - b_a) + g, ṗ = v, ḋ = 0; and ξ̇ = A ξ + Ad_X w, where A holds gₓ from rotation to
        velocity, I from velocity to position, and -R, -xₓ R from the biases.

        Args:
            angular_velocity: measured by the gyroscope during that time, (3,) in rad/s.
            specific_force: measured by the accelerometer, (3,) in m/s².
            dt: s.
        """
        R, noise, end = self.rotation, self.noise, 9 + 3 * len(self.names)
        turned = exp3((angular_velocity - self.gyroscope_bias) * dt)
        acceleration = R @ (specific_force - self.accelerometer_bias) + self._gravity
        # The covariance first: its matrices are those of the state before (as in the authors' own code).
        Phi = np.eye(len(self.P))
        Phi[_VELOCITY, _ROTATION] = hat(self._gravity) * dt
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
            adjoint[_POINTS + 3 * i : _POINTS + 3 * i + 3, 6 + 3 * i : 9 + 3 * i] = R * noise.contact
        adjoint[end:, -6:] = np.diag(np.repeat([noise.gyroscope_bias, noise.accelerometer_bias], 3))
        driven = Phi @ adjoint
        self.P = Phi @ self.P @ Phi.T + dt * (driven @ driven.T)
        self.columns[:, 1] += self.velocity * dt + 0.5 * dt**2 * acceleration
        self.columns[:, 0] += acceleration * dt
        self.rotation = R @ turned

    def innovation(self, names: Sequence[str], places: Array, covariance: Array) -> tuple[Array, Array]:
        """What kinematics contradict the estimate by, and how much of that is expected.

        Args:
            names: k names of contact points of the filter.
            places: their positions measured by the kinematics, from the IMU and in its axes, (k, 3) in m.
            covariance: of these positions, (3 k, 3 k) in m².

        Returns:
            R y + p - d of all points, (3 k,) in m, and its covariance, (3 k, 3 k).
        """
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

    def correct(self, names: Sequence[str], z: Array, S: Array) -> None:
        """Correct the state by kinematics: X ← exp(K z) X.

        Args:
            names: k names of contact points of the filter.
            z: by what they contradict the estimate, from `innovation`, (3 k,) in m.
            S: the covariance of z, (3 k, 3 k) in m².
        """
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

    def add(self, name: str, place: Array, covariance: Array) -> None:
        """Begin a contact point where the kinematics see it.

        Args:
            name: of the point.
            place: its position from the IMU, in its axes, (3,) in m.
            covariance: of that position, (3, 3) in m².
        """
        end = 9 + 3 * len(self.names)
        self.names.append(name)
        self.columns = np.column_stack([self.columns, self.position + self.rotation @ place])
        keep = np.concatenate([np.arange(end), np.arange(6, 9), np.arange(end, len(self.P))])
        self.P = self.P[np.ix_(keep, keep)]
        self.P[end : end + 3, end : end + 3] += self.rotation @ covariance @ self.rotation.T

    def remove(self, name: str) -> None:
        """End a contact point."""
        i = self.names.index(name)
        self.names.pop(i)
        self.columns = np.delete(self.columns, 2 + i, axis=1)
        gone = np.arange(_POINTS + 3 * i, _POINTS + 3 * i + 3)
        self.P = np.delete(np.delete(self.P, gone, axis=0), gone, axis=1)

    def _rows(self, names: Sequence[str]) -> np.ndarray:
        return np.concatenate([_POINTS + 3 * self.names.index(name) + np.arange(3) for name in names])

    def _apply(self, delta: Array) -> None:
        """X ← exp(δ) X, θ ← θ + δ_θ."""
        turn, end = delta[:3], 9 + 3 * len(self.names)
        R, V = exp3(turn), left_jacobian3(turn)
        self.rotation = R @ self.rotation
        self.columns = R @ self.columns + V @ delta[3:end].reshape(-1, 3).T
        self.gyroscope_bias = self.gyroscope_bias + delta[end : end + 3]
        self.accelerometer_bias = self.accelerometer_bias + delta[end + 3 :]


def hat(w: Array) -> Array:
    """The matrix w × of a vector, (3, 3)."""
    x, y, z = w.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def hats(vectors: Array) -> Array:
    """The matrix x × of each vector x, (k, 3) to (k, 3, 3)."""
    found = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    found[:, 0, 1], found[:, 0, 2], found[:, 1, 2] = -z, y, -x
    found[:, 1, 0], found[:, 2, 0], found[:, 2, 1] = z, -y, x
    return found


def exp3(w: Array) -> Array:
    """Exponential map of SO(3), (3, 3): the rotation by |w| about w."""
    a, b, _ = _coefficients(w)
    W = hat(w)
    return np.eye(3) + a * W + b * (W @ W)


def left_jacobian3(w: Array) -> Array:
    """Left Jacobian of SO(3), (3, 3)."""
    _, b, c = _coefficients(w)
    W = hat(w)
    return np.eye(3) + b * W + c * (W @ W)


def _coefficients(w: Array) -> tuple[float, float, float]:
    """The series sin θ / θ, (1 - cos θ) / θ² and (θ - sin θ) / θ³."""
    angle = math.sqrt(float(w @ w))
    if angle < _SMALL:
        return 1.0, 0.5, 1.0 / 6.0
    return (
        math.sin(angle) / angle,
        (1.0 - math.cos(angle)) / angle**2,
        (angle - math.sin(angle)) / angle**3,
    )
