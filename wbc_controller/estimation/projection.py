"""Projection of forces onto the motions that the contacts allow, and mobility of the joints on the contacts.

With N = I - M⁻¹ Jᵀ (J M⁻¹ Jᵀ)⁻¹ J, a force r accelerates a robot on its contacts by N M⁻¹ r = M⁻¹ Nᵀ r (Gauss's
principle, equation (31) of the note; S8).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dposv, dpotrf, dpotri, dpotrs

from wbc_controller.records import Array

#: Regularization of J M⁻¹ Jᵀ, as a share of its mean diagonal: contacts may constrain the same motion twice.
_RIDGE = 1.0e-9


def split_force(M: Array, J: Array, force: Array) -> tuple[Array, Array]:
    """Split generalized forces into the part that moves the robot and the contacts' part: r = Nᵀ r + Jᵀ λ.

    Args:
        M: mass matrix, (nv, nv).
        J: Jacobian of the contacts, (k, nv); its rows need not be independent.
        force: r, (nv,) in N, N·m.

    Returns:
        Nᵀ r, (nv,), and λ = (J M⁻¹ Jᵀ)⁻¹ J M⁻¹ r, (k,).
    """
    if not len(J):
        return force, np.zeros(0)
    spread: Array = dpotrs(dpotrf(M)[0], J.T)[0]  # M⁻¹ Jᵀ, (nv, k)
    contact_forces: Array = dposv(_delassus(J, spread), spread.T @ force)[1]
    return np.asarray(force - J.T @ contact_forces), contact_forces


def mobility(M: Array, J: Array) -> Array:
    """Return the acceleration of each coordinate per unit of force along it: the diagonal of N M⁻¹, (nv,).

    Its inverse is the effective inertia on the contacts. Arguments as for `split_force`.
    """
    factor = dpotrf(M)[0]
    free = np.diag(dpotri(factor)[0]).copy()
    if len(J):
        spread = dpotrs(factor, J.T)[0]
        free -= np.sum(spread.T * dposv(_delassus(J, spread), spread.T)[1], axis=0)
    return np.asarray(np.maximum(free, 0.0))


def _delassus(J: Array, spread: Array) -> Array:
    """Return J M⁻¹ Jᵀ, (k, k), regularized."""
    A = np.asarray(J @ spread)
    A[np.diag_indices(len(A))] += _RIDGE * float(np.trace(A)) / len(A)
    return A
