"""The actuators in the equations of motion: their generalized force, and its elimination."""

from __future__ import annotations

import numpy as np
from scipy.linalg import null_space

from wbc_controller.inverse_dynamics.arrays import as_slice
from wbc_controller.inverse_dynamics.robot.transmission import Drive
from wbc_controller.records import Array, frozen


class Actuation(Drive):
    """The generalized force of the actuators, Sᵀτ, and its elimination from the equations of motion (S1, S10).

    The speeds of the actuators are S v; by virtual work the generalized force of their torques is Sᵀτ (equation (20) of
    the note). Joints that follow others satisfy C v = 0 through a force Cᵀλ that does no work (equation (19); S3). With
    B = [S; C] of full row rank,

        M v̇ + h - Jᵀf = Sᵀτ + Cᵀλ    is    τ = T (M v̇ + h - Jᵀf)  and  N (M v̇ + h - Jᵀf) = 0

    where T consists of the first na rows of (B Bᵀ)⁻¹ B, and the rows of N are a basis of B's null space (the unactuated
    rows). The elimination of τ and λ from the decision variables is exact. If every actuator is the motor of one joint
    and no joint follows another, T and N only select rows, and no matrix product is needed.

    Attributes:
        S: actuation matrix, (na, nv).
        rotors: inertia of the rotors of transmissions, SᵀIS, (nv, nv) in kg·m²: as the rotor speeds are S v, it adds to
            M, and nothing to h; None if no transmission has rotor inertia.
        C: coupling rows of the joints that follow others, (nm, nv).
        free: number of rows of N.
        projection: [N; T] row by row: the begin of each row and the end of the last, (free + na + 1,), in its columns
            and values that are not zero.
        direct: whether every actuator is the motor of one joint, and no joint follows another.
    """

    def __init__(self, drive: Drive, v_index: np.ndarray, coupling: Array) -> None:
        """Make the actuation from the index in v of each joint, (nj,), and the coupling rows C, (nm, nv)."""
        super().__init__(
            drive.names, drive.effort_limits, drive.ratios, rotor_inertia=drive.rotor_inertia, by_joint=drive.by_joint
        )
        na, nv = len(drive.names), coupling.shape[1]
        self.S = np.zeros((na, nv))
        self.S[:, v_index] = drive.ratios
        self.S.setflags(write=False)
        self.rotors = self.S.T @ np.diag(self.rotor_inertia) @ self.S if self.rotor_inertia.any() else None
        self.C = frozen(coupling)
        self.free = nv - na - len(coupling)
        B = np.vstack([self.S, self.C])
        # Coordinates in which B is zero keep unit rows in N, so that N has the same form as when it only selects rows.
        # The leading coordinates, those of a floating base, come last.
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
        self.projection = (starts, columns.astype(np.int64), self._N_T[rows, columns])
        self.direct = self.motors is not None and not len(coupling)
        self._rows = as_slice(v_index[self.motors]) if self.direct else None
        self._all_rows = as_slice(np.concatenate([untouched, v_index[self.motors]])) if self.direct else None

    def split(self, force: Array) -> Array:
        """Project generalized forces, (nv,) or (nv, k), onto the rows N force, and below them the torques, T force.

        The result, (free + na,) or (free + na, k), may be a view of `force`.
        """
        return np.asarray(force[self._all_rows] if self._all_rows is not None else self._N_T @ force)

    def torques(self, force: Array) -> Array:
        """Actuator torques that correspond to a generalized force, T force: (nv,) to (na,)."""
        return self.split(force)[self.free :]

    def generalized_force(self, tau: Array) -> Array:
        """Sᵀτ, (na,) to (nv,)."""
        return np.asarray(tau @ self.S)

    def speeds(self, v: Array) -> Array:
        """Speeds of the actuators, S v: (nv,) to (na,)."""
        return np.asarray(v[self._rows] if self._rows is not None else self.S @ v)
