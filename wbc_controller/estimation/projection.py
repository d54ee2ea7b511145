"""Projection of forces onto permitted motions.

With N = I - M⁻¹ Jᵀ (J M⁻¹ Jᵀ)⁻¹ J, a force r accelerates a robot on its contacts by N M⁻¹ r = M⁻¹ Nᵀ r (Gauss's
principle, equation (31) of the note; S8).
"""

import numpy as np
from scipy.linalg.lapack import dposv, dpotrf, dpotri, dpotrs

from wbc_controller.records import Array

_RIDGE = 1.0e-9  # regularization of J M⁻¹ Jᵀ for redundant contacts, as a share of its mean diagonal


def split_force(M: Array, J: Array, force: Array) -> tuple[Array, Array]:
    """Split generalized forces, r = Nᵀ r + Jᵀ λ; return Nᵀ r, (nv,), and λ = (J M⁻¹ Jᵀ)⁻¹ J M⁻¹ r, (k,).

    M is the mass matrix, (nv, nv), and J the contact Jacobian, (k, nv), with possibly dependent rows.
    """
    if not len(J):
        return force, np.zeros(0)
    spread: Array = dpotrs(dpotrf(M)[0], J.T)[0]  # M⁻¹ Jᵀ, (nv, k)
    contact_forces: Array = dposv(_delassus(J, spread), spread.T @ force)[1]
    return np.asarray(force - J.T @ contact_forces), contact_forces


def mobility(M: Array, J: Array) -> Array:
    """Return the diagonal of N M⁻¹, (nv,), the inverse of the effective inertias on the contacts."""
    factor = dpotrf(M)[0]
    free = np.diag(dpotri(factor)[0]).copy()
    if len(J):
        spread = dpotrs(factor, J.T)[0]
        free -= np.sum(spread.T * dposv(_delassus(J, spread), spread.T)[1], axis=0)
    return np.asarray(np.maximum(free, 0.0))


def _delassus(J: Array, spread: Array) -> Array:
    A = np.asarray(J @ spread)
    A[np.diag_indices(len(A))] += _RIDGE * float(np.trace(A)) / len(A)
    return A
