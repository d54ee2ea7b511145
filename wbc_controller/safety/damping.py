"""Largest joint damping stable in discrete time."""

import math

import numpy as np
import pinocchio as pin
from scipy.linalg import eigh

from wbc_controller.inverse_dynamics.robot.dynamics import Mobility
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.robot.transmission import Drive
from wbc_controller.records import Array

_LARGEST_RATE = 0.9  # largest T λ; a sampled loop is stable below 2, with one more period of delay below 1
_TOLERANCE = 0.02  # tolerance of a search, as a share
_SEARCHES, _FEW_SEARCHES = 6, 2  # consecutive searches without a reduction, and number without near rates
_STEPS, _MOTIONS = 20, 6  # steps of a search, and number of eigenvectors in its direction
_EXPONENT = 8  # exponent p of (Σ λᵢᵖ)^(1/p), the smooth maximum of a search over all limbs


class _Search:
    """Rates T λ at which damping changes the joint velocities, as a function of the posture.

    Torques -D v over a period T change v to (I - T W D) v, where W is the joints' block of M⁻¹ with a free base. T λ
    are the eigenvalues of T D^½ W D^½. P W P replaces W if actuators drive several joints, with the projection P on
    damped motions.
    """

    def __init__(self, model: RobotModel, period: float) -> None:
        self._model, self._period = model, period
        self._data = model.pinocchio.createData()
        self._mobility = Mobility(model)
        self._projection = damped_motions(model.actuation)
        lower = np.minimum(np.maximum(model.position_lower, -math.pi), model.posture)
        self.range = lower, np.maximum(np.minimum(model.position_upper, math.pi), model.posture)

    def rates(self, D: Array, posture: Array) -> tuple[Array, Array]:
        """Return increasing rates T λ at a posture, (nj,), and the motions D^½ v, (nj, nj) by columns."""
        return self._eigen(D, self._mobility(self._model.configuration(posture)))

    def fastest(self, D: Array, start: Array) -> Array:
        """Search the posture with the largest rates within the limits by RPROP (Riedmiller, Braun, ICNN 1993)."""
        lower, upper = self.range
        posture, found, largest = start, start, -math.inf
        step, before = 0.1 * (upper - lower), np.zeros(len(start))
        for _ in range(_STEPS):
            norm, gradient = self._norm(D, posture)
            if norm > largest:
                largest, found = norm, posture
            step = step * np.where(gradient * before < 0.0, 0.5, 1.2)
            posture, before = np.clip(posture + np.sign(gradient) * step, lower, upper), gradient
        return found

    def _norm(self, D: Array, posture: Array) -> tuple[float, Array]:
        """Return (Σ λᵢᵖ)^(1/p) and its gradient: dλ = -xᵀ dM x with x = M⁻¹ D^½ u, ∂(xᵀMx)/∂q = 2 Cᵀ(q, x) x."""
        model = self._model
        q = model.configuration(posture)
        inverse = self._mobility(q)
        rates, motions = self._eigen(D, inverse)
        norm = float(np.sum(np.maximum(rates, 0.0) ** _EXPONENT) ** (1.0 / _EXPONENT))
        gradient = np.zeros(model.nv)
        if norm > 0.0:
            velocities = inverse[:, model.v_index] @ self._projection @ (np.sqrt(self._period * D)[:, None] * motions)
            for rate, x in zip(rates[-_MOTIONS:], velocities.T[-_MOTIONS:], strict=True):
                C = pin.computeCoriolisMatrix(model.pinocchio, self._data, q, np.ascontiguousarray(x))
                gradient -= 2.0 * (max(rate, 0.0) / norm) ** (_EXPONENT - 1) * (C.T @ x)
        return norm, model.joint_forces(gradient)

    def _eigen(self, D: Array, inverse: Array) -> tuple[Array, Array]:
        root = np.sqrt(self._period * D)
        joints = self._model.v_index
        W = self._projection @ inverse[np.ix_(joints, joints)] @ self._projection
        # This routine, unlike NumPy's, starts no threads.
        rates, motions = eigh(root[:, None] * W * root, driver="evr")
        return rates, motions


def stable_damping(model: RobotModel, damping: float, period: float) -> Array:
    """Compute the damping of each joint, (nj,), less than wanted if a posture makes it unstable.

    D is reduced until searches from the nominal and random postures find no T λ above 0.9 (`_Search`). `damping` is in
    N·m·s/rad; `period` T includes the delay of the velocities, s.
    """
    search = _Search(model, period)
    lower, upper = search.range
    random = np.random.default_rng(0)
    D = _reduced(search, np.full(model.nj, damping), model.posture)
    calm, largest = 0, 0.0
    while calm < (_SEARCHES if largest > 0.5 * _LARGEST_RATE else _FEW_SEARCHES):
        posture = search.fastest(D, random.uniform(lower, upper))
        rate = float(search.rates(D, posture)[0][-1])
        largest, calm = max(largest, rate), calm + 1
        if rate > (1.0 + _TOLERANCE) * _LARGEST_RATE:
            D, calm = _reduced(search, D, posture), 0
    return D


def _reduced(search: _Search, D: Array, posture: Array) -> Array:
    """Reduce D until no rate exceeds the largest, each joint by its share in the fastest motion."""
    while True:
        rates, motions = search.rates(D, posture)
        if rates[-1] <= _LARGEST_RATE:
            return D
        share = motions[:, -1] ** 2
        D = D * (0.98 * _LARGEST_RATE / rates[-1]) ** (share / share.max())


def damped_motions(drive: Drive) -> Array:
    """Return the projection P on joint motions that actuators damp, (nj, nj)."""
    return np.asarray(drive.ratios.T @ drive.from_joints(np.eye(drive.ratios.shape[1])))


def damping_matrix(drive: Drive, D: Array) -> Array:
    """Return K, (na, nj), of the torques -K v; their power -vᵀPDPv is never positive."""
    return drive.from_joints(D[:, None] * damped_motions(drive))
