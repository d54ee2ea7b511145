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

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wbc_controller.estimation import invariant_filter_kernels as kernel
from wbc_controller.inverse_dynamics.arrays import solved
from wbc_controller.records import Array

#: First row of the covariance of the first contact point.
_POINTS = 9


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
        """Begin without contact points; gravity is in the world, (3,) in m/s², and P is (15, 15)."""
        self.noise = noise
        self._densities = np.array(
            [noise.gyroscope, noise.accelerometer, noise.gyroscope_bias, noise.accelerometer_bias, noise.contact]
        )
        self._gravity = np.array(gravity)
        self.rotation = np.array(rotation)
        self.columns = np.ascontiguousarray(np.column_stack([velocity, position]))
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
        """Predict the state after a time dt, s: strapdown integration, and the linear error dynamics.

        Ṙ = R (ω - b_g)ₓ, v̇ = R (a - b_a) + g, ṗ = v, ḋ = 0; and ξ̇ = A ξ + Ad_X w, where A holds gₓ from rotation to
        velocity, I from velocity to position, and -R, -xₓ R from the biases. ω and a are measured during that time,
        (3,) in rad/s and m/s².
        """
        before = self.rotation, self.columns, self.gyroscope_bias, self.accelerometer_bias, self.P
        self.rotation, self.columns, self.P = np.empty((3, 3)), np.empty(before[1].shape), np.empty(before[4].shape)
        # The covariance goes with the state before, as in the authors' own code.
        kernel.propagate(
            *before, self._gravity, angular_velocity, specific_force, dt, self._densities,
            self.rotation, self.columns, self.P,
        )  # fmt: skip

    def correct(
        self,
        names: Sequence[str],
        places: Array,
        covariance: Array,
        *,
        ends: np.ndarray | None = None,
        limits: Array | None = None,
    ) -> Array:
        """Correct the state by kinematics, X ← exp(K z) X, unless what a group of points contradicts by is too much.

        With z = R y + p - d of all points and its covariance S, the square of a group is zᵀ S⁻¹ z of its own points.

        Args:
            names: k names of contact points of the filter.
            places: y, their positions measured by the kinematics, from the IMU and in its axes, (k, 3) in m.
            covariance: of these positions, (3 k, 3 k) in m².
            ends: after which of the points each group ends, (c,); by default they are one group.
            limits: the largest square of each group, (c,); by default any.

        Returns:
            The squares, (c,). Where one is not within its limit, or NaN, nothing is corrected.

        Raises:
            LinAlgError: where S is not positive definite.
        """
        ends = np.array([len(names)]) if ends is None else ends
        limits = np.full(len(ends), np.inf) if limits is None else limits
        squares = np.empty(len(ends))
        before = self.rotation, self.columns, self.gyroscope_bias, self.accelerometer_bias, self.P
        after = np.empty((3, 3)), np.empty(self.columns.shape), np.empty(3), np.empty(3), np.empty(self.P.shape)
        points = np.array([self.names.index(name) for name in names], dtype=np.int64)
        found = kernel.correct(*before, points, ends, places, covariance, limits, squares, *after)
        if found < 0:
            raise np.linalg.LinAlgError("the covariance of the innovation is not positive definite")
        if found > 0:
            self.rotation, self.columns, self.gyroscope_bias, self.accelerometer_bias, self.P = after
        return squares

    def correct_world(self, H: Array, z: Array, noise: Array, at: Array) -> tuple[float, Array]:
        """Correct where the world's heading and origin are, which nothing on the robot observes: X ← T X.

        T turns by w_ψ about the vertical, and shifts so that x comes to x + w, with (w, w_ψ) = W z and the gain of
        what z observes alone, W = H P Hᵀ S⁻¹. That is K z with K = G W in the place of P Hᵀ S⁻¹, where G ∈ R^{n×4}
        are those motions as errors, H G = I: they are not seen by contacts, and time leaves them as they are. Tilt,
        velocity and accelerometer stay those of the IMU and the contacts. The gyroscope's bias about the vertical,
        which contacts do not see either, is corrected by its own part of P Hᵀ S⁻¹. For any K,
        P ← (I - K H) P (I - K H)ᵀ + K N Kᵀ.

        Args:
            H: what is observed of the error (ξ, δb): z = -H ξ and noise, (4, 15 + 3 N).
            z: by what place and heading of x contradict the estimate, (4,) in m and rad.
            noise: N, its covariance, (4, 4).
            at: x, (3,) in m.

        Returns:
            Turn and shift of T, in rad and m.
        """
        seen = self.P @ H.T  # (n, 4)
        S = H @ seen + noise
        K = self._motions(at) @ solved(S, H @ seen).T
        up = self.rotation[2]  # in the axes of the IMU
        K[-6:-3] = np.outer(up, solved(S, up @ seen[-6:-3]))
        kept = np.eye(len(K)) - K @ H
        P = kept @ self.P @ kept.T + K @ noise @ K.T
        self.P = 0.5 * (P + P.T)
        step = H @ K @ z
        turn = float(step[3])
        c, s = np.cos(turn), np.sin(turn)
        T = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        shift = at + step[:3] - T @ at
        self.gyroscope_bias = self.gyroscope_bias + K[-6:-3] @ z
        self._turned(T, shift)
        return turn, shift

    def _motions(self, at: Array) -> Array:
        """G: the errors of shifts of the world, and of a turn about the vertical through a point, (n, 4)."""
        G = np.zeros((len(self.P), 4))
        G[2, 3] = 1.0
        for row in range(6, len(G) - 6, 3):
            G[row : row + 3, :3], G[row : row + 3, 3] = np.eye(3), hat(at)[:, 2]
        return G

    def _turned(self, rotation: Array, shift: Array) -> None:
        self.rotation = rotation @ self.rotation
        self.columns = rotation @ self.columns
        self.columns[:, 1:] += shift[:, None]

    def move(self, rotation: Array, shift: Array, at: Array, covariance: Array) -> None:
        """Express everything in another world, which is turned about the vertical: X ← T X, ξ ← Ad_T ξ.

        Velocities turn and points move: Ad_T takes ξ_R to R_T ξ_R, ξ_v to R_T ξ_v, and the ξ of p and d to
        R_T ξ + t × R_T ξ_R. What is not known of T is an error of turn δψ about z and of place δ of one point x:
        ξ_R grows by z δψ, and the ξ of p and d by δ + x × z δψ.

        Args:
            rotation: R_T, (3, 3), about z.
            shift: t, (3,) in m.
            at: x, in the new world, (3,) in m.
            covariance: of (δ, δψ), (4, 4) in m² and rad².
        """
        n = len(self.P)
        Ad, G = np.eye(n), self._motions(at)
        for row in range(0, n - 6, 3):
            Ad[row : row + 3, row : row + 3] = rotation
        for row in range(6, n - 6, 3):
            Ad[row : row + 3, :3] = hat(shift) @ rotation
        self.P = Ad @ self.P @ Ad.T + G @ covariance @ G.T
        self._turned(rotation, shift)

    def add(self, name: str, place: Array, covariance: Array) -> None:
        """Begin a contact point at its place seen by the kinematics, (3,) in m from the IMU; covariance (3, 3)."""
        end = 9 + 3 * len(self.names)
        self.names.append(name)
        self.columns = np.ascontiguousarray(np.column_stack([self.columns, self.position + self.rotation @ place]))
        keep = np.concatenate([np.arange(end), np.arange(6, 9), np.arange(end, len(self.P))])
        self.P = np.ascontiguousarray(self.P[np.ix_(keep, keep)])
        self.P[end : end + 3, end : end + 3] += self.rotation @ covariance @ self.rotation.T

    def remove(self, name: str) -> None:
        """End a contact point."""
        i = self.names.index(name)
        self.names.pop(i)
        self.columns = np.ascontiguousarray(np.delete(self.columns, 2 + i, axis=1))
        gone = np.arange(_POINTS + 3 * i, _POINTS + 3 * i + 3)
        self.P = np.ascontiguousarray(np.delete(np.delete(self.P, gone, axis=0), gone, axis=1))


def hat(w: Array) -> Array:
    """The matrix w × of a vector, (3, 3)."""
    x, y, z = w.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
