"""Generalized force of the actuators."""

import numpy as np
from scipy.linalg import null_space

from wbc_controller.inverse_dynamics.robot.transmission import Drive
from wbc_controller.records import Array, frozen


class Actuation(Drive):
    """Generalized force of the actuators, Sᵀτ, and its elimination from the equations of motion (S1, S10).

    The actuator speeds are S v, so by virtual work torques τ give the generalized force Sᵀτ (equation (20) of the
    note). Mimic joints satisfy C v = 0 by a constraint force Cᵀλ (equation (19); S3). With B = [S; C] of full row rank,

        M v̇ + h - Jᵀf = Sᵀτ + Cᵀλ    ⇔    τ = T (M v̇ + h - Jᵀf)  and  N (M v̇ + h - Jᵀf) = 0

    where T contains the first na rows of (B Bᵀ)⁻¹ B, and N a basis of the null space of B.
    """

    def __init__(self, drive: Drive, v_index: np.ndarray, coupling: Array) -> None:
        """Make the actuation from the joints' indices in v, (nj,), and the coupling rows C, (nm, nv)."""
        super().__init__(
            drive.names, drive.effort_limits, drive.ratios, rotor_inertia=drive.rotor_inertia, by_joint=drive.by_joint
        )
        na, nv = len(drive.names), coupling.shape[1]
        self.S = np.zeros((na, nv))
        self.S[:, v_index] = drive.ratios
        self.S.setflags(write=False)
        #: Rotor inertia of transmissions, added to M, (nv, nv) in kg·m²; or None.
        self.rotors = self.S.T @ np.diag(self.rotor_inertia) @ self.S if self.rotor_inertia.any() else None
        self.C = frozen(coupling)
        self.free = nv - na - len(coupling)  # number of rows of N
        B = np.vstack([self.S, self.C])
        # Coordinates without entries in B keep unit rows in N.
        entered = np.flatnonzero(B.any(axis=0))
        untouched = np.setdiff1d(np.arange(nv), entered)
        leading = untouched == np.arange(len(untouched))
        untouched = np.concatenate([untouched[~leading], untouched[leading]])
        N = np.zeros((self.free, nv))
        N[self.free - len(untouched) + np.arange(len(untouched)), untouched] = 1.0
        N[: self.free - len(untouched), entered] = null_space(B[:, entered]).T
        self._N_T = np.vstack([N, np.linalg.solve(B @ B.T, B)[:na]])
        rows, columns = self._N_T.nonzero()
        starts = np.searchsorted(rows, np.arange(len(self._N_T) + 1)).astype(np.int64)
        #: [N; T] in compressed rows: starts of rows and end, (free + na + 1,); columns; values.
        self.projection = (starts, columns.astype(np.int64), self._N_T[rows, columns])

    def split(self, force: Array) -> Array:
        """Return [N force; T force] of forces (nv,) or (nv, k)."""
        return np.asarray(self._N_T @ force)

    def torques(self, force: Array) -> Array:
        """Return the actuator torques T force, (nv,) to (na,)."""
        return self.split(force)[self.free :]

    def generalized_force(self, tau: Array) -> Array:
        """Return Sᵀτ, (na,) to (nv,)."""
        return np.asarray(tau @ self.S)
