"""The motions that contacts leave to a robot: what of forces moves it, and how easily each joint moves.

With N = I - M⁻¹ Jᵀ (J M⁻¹ Jᵀ)⁻¹ J, a force r accelerates a robot on its contacts by N M⁻¹ r = M⁻¹ Nᵀ r (Gauss's
principle, equation (31) of the note; S8).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dposv, dpotrf, dpotri, dpotrs

from wbc_controller.records import Array

#: What is added to the diagonal of J M⁻¹ Jᵀ, as a share of its mean: contacts may hold the same motion twice.
_RIDGE = 1.0e-9


def parts(M: Array, J: Array, force: Array) -> tuple[Array, Array]:
    """What of generalized forces moves a robot on its contacts, and what the contacts take up: r = Nᵀ r + Jᵀ λ.

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
    held: Array = dposv(_delassus(J, spread), spread.T @ force)[1]
    return np.asarray(force - J.T @ held), held


def mobility(M: Array, J: Array) -> Array:
    """Acceleration of each coordinate for a unit of force along it on the contacts: the diagonal of N M⁻¹, (nv,).

    Its inverse is the inertia that the force has to move. Arguments as for `parts`.
    """
    factor = dpotrf(M)[0]
    free = np.diag(dpotri(factor)[0]).copy()
    if len(J):
        spread = dpotrs(factor, J.T)[0]
        free -= np.sum(spread.T * dposv(_delassus(J, spread), spread.T)[1], axis=0)
    return np.asarray(np.maximum(free, 0.0))


def _delassus(J: Array, spread: Array) -> Array:
    """J M⁻¹ Jᵀ, (k, k), with what makes it regular."""
    A = np.asarray(J @ spread)
    A[np.diag_indices(len(A))] += _RIDGE * float(np.trace(A)) / len(A)
    return A
