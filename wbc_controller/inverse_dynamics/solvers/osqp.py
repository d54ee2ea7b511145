"""OSQP, an operator-splitting solver."""

import numpy as np
import osqp
from scipy import sparse

from wbc_controller.inverse_dynamics.formulation.problem import Answer, QuadraticProgram
from wbc_controller.inverse_dynamics.solvers.solver import Solver


class OsqpSolver(Solver):
    """OSQP with dense matrices, for constant sparsity.

    Source: Stellato et al., Mathematical Programming Computation, 2020.
    """

    tolerance = 1.0e-3
    for_levels = False  # too many iterations for random problems

    def __init__(self, n: int, equalities: int, inequalities: int) -> None:
        rows = equalities + inequalities
        self._rows = np.zeros((n + rows, n))
        self._rows[rows:] = np.eye(n)  # bounds of x
        self._equalities = equalities
        self._solver: osqp.OSQP | None = None
        # Upper triangle of H, and rows above the identity, by columns (CSC).
        self._h_columns, self._h_rows = np.tril_indices(n)
        self._h_starts = np.append(0, np.cumsum(np.arange(1, n + 1)))
        self._a_columns, self._a_rows = np.vstack([np.ones((rows, n)), np.eye(n)]).T.nonzero()
        self._a_starts = np.arange(n + 1) * (rows + 1)

    def _search(self, problem: QuadraticProgram) -> Answer:
        n, m, rows = problem.n, self._equalities, len(problem.b) + len(problem.upper)
        self._rows[:m] = problem.A
        self._rows[m:rows] = problem.C
        h_values = problem.H[self._h_rows, self._h_columns]
        a_values = self._rows[self._a_rows, self._a_columns]
        lower = np.concatenate([problem.b, problem.lower, problem.x_lower])
        upper = np.concatenate([problem.b, problem.upper, problem.x_upper])
        try:
            if self._solver is None:
                self._solver = osqp.OSQP()
                self._solver.setup(
                    P=sparse.csc_matrix((h_values, self._h_rows, self._h_starts), shape=(n, n)),
                    q=problem.g,
                    A=sparse.csc_matrix((a_values, self._a_rows, self._a_starts), shape=self._rows.shape),
                    l=lower,
                    u=upper,
                    verbose=False,
                    eps_abs=1.0e-5,
                    eps_rel=1.0e-5,
                    max_iter=4000,
                    polishing=self._equalities > 0,  # prints a line without equalities
                    check_termination=5,
                )
            else:
                self._solver.update(q=problem.g, l=lower, u=upper, Px=h_values, Ax=a_values)
            result = self._solver.solve(raise_error=False)
        except osqp.OSQPException as error:  # singular matrices
            self._solver = None
            return Answer(None, f"OSQPException: {error}", 0)
        iterations = int(result.info.iter)
        if result.info.status == "solved":
            y = np.array(result.y)
            return Answer(np.array(result.x), "optimal", iterations, np.concatenate([y[rows:], y[m:rows]]))
        self._solver = None
        return Answer(None, str(result.info.status), iterations)
