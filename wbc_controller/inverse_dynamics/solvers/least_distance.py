"""Least-distance programming, by non-negative least squares."""

import numpy as np
from scipy.linalg import LinAlgError, solve_triangular
from scipy.optimize import nnls

from wbc_controller.inverse_dynamics.formulation.problem import Answer, QuadraticProgram
from wbc_controller.records import Array

_NO_ROW = 1.0e-12  # norm of a row independent of x
_FEASIBLE = 1.0e-9  # 1 / (1 + ‖y‖²), with normalized y


def solve_by_least_distance(problem: QuadraticProgram) -> Answer:
    """Solve a problem without equalities and bounds of x, possibly with a thin feasible set.

    With H = L Lᵀ and y = Lᵀx + L⁻¹g, minimize ‖y‖² subject to G y ≥ h. From min ‖E u - e‖ over u ≥ 0, with E = [Gᵀ;
    hᵀ], e = [0; 1] and r = E u - e, follow y = -r₁…ₙ / rₙ₊₁ and the multipliers -u / rₙ₊₁ (Lawson, Hanson, "Solving
    least squares problems", 1974, chapter 23). Robust; slower than DAQP.
    """
    upper, lower = np.isfinite(problem.upper), np.isfinite(problem.lower)
    try:
        L = np.linalg.cholesky(problem.H)
        G = solve_triangular(L, np.vstack([-problem.C[upper], problem.C[lower]]).T, lower=True).T
        origin = solve_triangular(L, problem.g, lower=True)
        h = np.concatenate([-problem.upper[upper], problem.lower[lower]]) + G @ origin
        sizes = np.linalg.norm(G, axis=1)
        rows = sizes > _NO_ROW
        # Unit of y for ‖y‖ ≈ 1: its size without constraints, or the distance of the farthest constraint.
        unit = max(float(np.linalg.norm(origin)), float((h[rows] / sizes[rows]).max(initial=0.0)), _NO_ROW)
        E = np.vstack([G[rows].T, h[rows] / unit]) / sizes[rows]
        u, _ = nnls(E, np.append(np.zeros(problem.n), 1.0))
    except (LinAlgError, RuntimeError) as error:  # H is not positive definite, or too many iterations
        return Answer(None, f"{type(error).__name__}: {error}", 0)
    r: Array = E @ u
    r[-1] -= 1.0
    if not r[-1] < -_FEASIBLE:
        return Answer(None, "infeasible", 0)
    multipliers, sides = np.zeros((2, len(problem.upper))), np.zeros(len(rows))
    sides[rows] = -unit * u / r[-1] / sizes[rows]
    multipliers[0, upper], multipliers[1, lower] = np.split(sides, [int(upper.sum())])
    x = solve_triangular(L.T, -unit * r[:-1] / r[-1] - origin)
    return Answer(x, "optimal", 1, np.concatenate([np.zeros(problem.n), multipliers[0] - multipliers[1]]))
