"""Contact-aided right-invariant extended Kalman filter.

The world-centric filter of Hartley, Jadidi, Grizzle and Eustice, "Contact-aided invariant extended Kalman filtering for
robot state estimation" (International Journal of Robotics Research, 2020), with orientation R, velocity v and position
p of the IMU, contact points dᵢ, and biases θ:

        | R  v  p  d₁ … d_N |
    X = | 0       I         |,    θ = (b_g, b_a)

The error X̂ X⁻¹ = exp(ξ) depends on the state only through the biases: the filter converges from large errors, and yaw
and position remain unobservable.
"""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from wbc_controller.estimation import invariant_filter_kernels as kernel
from wbc_controller.inverse_dynamics.arrays import solved
from wbc_controller.inverse_dynamics.robot.orientation import planar_transform
from wbc_controller.records import Array
from wbc_controller.settings.estimation import EstimationSettings

_POINTS = 9  # first row of the first contact point in P


class InvariantFilter:
    """Right-invariant extended Kalman filter of an IMU and contact points."""

    def __init__(
        self, settings: EstimationSettings, gravity: Array, *, rotation: Array, velocity: Array, position: Array,
        gyroscope_bias: Array, accelerometer_bias: Array, P: Array,
    ) -> None:  # fmt: skip
        """Start without contact points; gravity is in the world, (3,) in m/s², and P is (15, 15)."""
        self.settings = settings
        noise = settings.gyroscope_noise, settings.accelerometer_noise
        self._densities = np.array([*noise, settings.gyroscope_bias_walk, settings.accelerometer_bias_walk])
        self._gravity = np.array(gravity)
        self.rotation = np.array(rotation)  # R, (3, 3), from IMU axes to the world
        self.columns = np.ascontiguousarray(np.column_stack([velocity, position]))  # v, p, d₁ … d_N, (3, 2 + N)
        self.gyroscope_bias = np.array(gyroscope_bias)  # b_g, (3,) in rad/s
        self.accelerometer_bias = np.array(accelerometer_bias)  # b_a, (3,) in m/s²
        self.P = np.array(P)  # of (ξ_R, ξ_v, ξ_p, ξ_d₁ …, b_g, b_a), (15 + 3 N, 15 + 3 N)
        self.names: list[str] = []  # of the points

    @property
    def velocity(self) -> Array:
        """v, (3,) in m/s."""
        return self.columns[:, 0]

    @property
    def position(self) -> Array:
        """p, (3,) in m."""
        return self.columns[:, 1]

    def propagate(self, angular_velocity: Array, specific_force: Array, dt: float, creep: Array | None = None) -> None:
        """Propagate by dt, s: strapdown integration and linear error dynamics.

        Ṙ = R (ω - b_g)ₓ, v̇ = R (a - b_a) + g, ṗ = v, ḋ = 0, ξ̇ = A ξ + Ad_X w. A contains gₓ (rotation to velocity), I
        (velocity to position), and -R, -xₓ R (biases). `creep` is the noise density of each contact point, (N,) in
        m/s/√Hz, by default that of `settings`.
        """
        creep = np.full(len(self.names), self.settings.contact_noise) if creep is None else creep
        self.rotation, self.columns, self.P = kernel.propagate(
            *self._state, self._gravity, angular_velocity, specific_force, dt, self._densities, creep
        )

    @property
    def _state(self) -> tuple[Array, Array, Array, Array, Array]:
        return self.rotation, self.columns, self.gyroscope_bias, self.accelerometer_bias, self.P

    def correct(
        self, names: Sequence[str], positions: Array, covariance: Array, *, ends: np.ndarray | None = None,
        limits: Array | None = None,
    ) -> Array:  # fmt: skip
        """Correct the state by kinematics, X ← exp(K z) X, and return zᵀ S⁻¹ z of each group of points, (c,).

        z = R y + p - d has the covariance S, with y in IMU axes, (k, 3) in m, and its covariance, (3 k, 3 k) in m².
        `ends` are the indices after each group, (c,). A square above its limit, (c,), or NaN, leaves the state
        unchanged. Raises LinAlgError if S is not positive definite.
        """
        ends = np.array([len(names)]) if ends is None else ends
        limits = np.full(len(ends), np.inf) if limits is None else limits
        points = np.array([self.names.index(name) for name in names], dtype=np.int64)
        squares, *after = kernel.correct(*self._state, points, ends, positions, covariance)
        if (squares <= limits).all():
            self.rotation, self.columns, self.gyroscope_bias, self.accelerometer_bias, self.P = after
        return squares

    def correct_world(self, H: Array, z: Array, noise: Array, at: Array) -> pin.SE3:
        """Correct heading and origin of the world, X ← T X; return T.

        T rotates by w_ψ about the vertical and moves x (`at`) to x + w, with (w, w_ψ) = H P Hᵀ S⁻¹ z. The gain is K = G
        H P Hᵀ S⁻¹, where G ∈ R^{n×4} are these unobservable motions as errors, H G = I. P ← (I - K H) P (I - K H)ᵀ + K
        N Kᵀ for any K.

        Args:
            H, z: z = -H ξ + noise, innovation of position and heading of x, (4, 15 + 3 N), and (4,) in m and rad.
            noise, at: covariance N, (4, 4), and x, (3,) in m.
        """
        seen = self.P @ H.T  # (n, 4)
        S = H @ seen + noise
        K = self._world_errors(at) @ solved(S, H @ seen).T
        up = self.rotation[2]  # in the axes of the IMU
        K[-6:-3] = np.outer(up, solved(S, up @ seen[-6:-3]))
        kept = np.eye(len(K)) - K @ H
        P = kept @ self.P @ kept.T + K @ noise @ K.T
        self.P = 0.5 * (P + P.T)
        step = H @ K @ z
        T = planar_transform(float(step[3]), at, at + step[:3])
        self.gyroscope_bias = self.gyroscope_bias + K[-6:-3] @ z
        self._transform(T)
        return T

    def _world_errors(self, at: Array) -> Array:
        """Return G for a rotation through a point, (n, 4)."""
        G = np.zeros((len(self.P), 4))
        G[2, 3] = 1.0
        for row in range(6, len(G) - 6, 3):
            G[row : row + 3, :3], G[row : row + 3, 3] = np.eye(3), pin.skew(at)[:, 2]
        return G

    def _transform(self, T: pin.SE3) -> None:
        self.rotation = T.rotation @ self.rotation
        self.columns = T.rotation @ self.columns
        self.columns[:, 1:] += T.translation[:, None]

    def move(self, T: pin.SE3, at: Array, covariance: Array) -> None:
        """Express the state in another world with the same vertical: X ← T X, ξ ← Ad_T ξ.

        Ad_T maps ξ_R and ξ_v to R_T ξ, and the ξ of p and d to R_T ξ + t × R_T ξ_R. The uncertainty of T, a rotation δψ
        about z and a translation δ of x (`at`, in the new world), adds z δψ to ξ_R, and δ + x × z δψ to the ξ of p and
        d; its covariance is (4, 4) of (δ, δψ).
        """
        n = len(self.P)
        Ad, G = np.eye(n), self._world_errors(at)
        for row in range(0, n - 6, 3):
            Ad[row : row + 3, row : row + 3] = T.rotation
        for row in range(6, n - 6, 3):
            Ad[row : row + 3, :3] = pin.skew(T.translation) @ T.rotation
        self.P = Ad @ self.P @ Ad.T + G @ covariance @ G.T
        self._transform(T)

    def add(self, name: str, place: Array, covariance: Array) -> None:
        """Add a contact point at y from the IMU in its axes, (3,) in m, with covariance (3, 3)."""
        end = 9 + 3 * len(self.names)
        self.names.append(name)
        self.columns = np.ascontiguousarray(np.column_stack([self.columns, self.position + self.rotation @ place]))
        keep = np.concatenate([np.arange(end), np.arange(6, 9), np.arange(end, len(self.P))])
        self.P = np.ascontiguousarray(self.P[np.ix_(keep, keep)])
        self.P[end : end + 3, end : end + 3] += self.rotation @ covariance @ self.rotation.T

    def remove(self, name: str) -> None:
        """Remove a contact point."""
        i = self.names.index(name)
        self.names.pop(i)
        self.columns = np.ascontiguousarray(np.delete(self.columns, 2 + i, axis=1))
        gone = np.arange(_POINTS + 3 * i, _POINTS + 3 * i + 3)
        self.P = np.ascontiguousarray(np.delete(np.delete(self.P, gone, axis=0), gone, axis=1))
