"""DAQP, a dual active-set solver: persistent workspace, warm-started from the last active set."""

from __future__ import annotations

import daqp
import numpy as np

from wbc_controller.core.problem import QuadraticProgram
from wbc_controller.core.solvers.solver import Answer, Solver

_EQUALITY = 5
_INFINITY = 1.0e30
_STATUS = {
    1: "optimal",
    2: "soft optimal",
    -1: "infeasible",
    -2: "cycling",
    -3: "unbounded",
    -4: "iteration limit",
    -5: "nonconvex",
    -6: "overdetermined initial active set",
    -7: "time limit",
}


class DaqpSolver(Solver):
    """DAQP.

    From Arnström, Bemporad, Axehill, "A dual active-set solver for embedded quadratic programming using recursive LDLᵀ
    updates" (IEEE Transactions on Automatic Control, 2022).
    """

    tolerance = 1.0e-5

    def __init__(self, n: int, equalities: int, inequalities: int) -> None:
        rows = equalities + inequalities
        self._equalities = equalities
        self._A = np.zeros((rows, n))
        self._upper = np.zeros(n + rows)
        self._lower = np.zeros(n + rows)
        self._sense = np.zeros(n + rows, dtype=np.int32)
        self._sense[n : n + equalities] = _EQUALITY
        self._model: daqp.Model | None = None

    def solve(self, problem: QuadraticProgram) -> Answer:
        """Solve a problem."""
        n, m = len(problem.g), self._equalities
        self._A[:m] = problem.A
        self._A[m:] = problem.C
        for out, x_bound, b, bound in (
            (self._upper, problem.x_upper, problem.b, problem.upper),
            (self._lower, problem.x_lower, problem.b, problem.lower),
        ):
            out[:n] = x_bound
            out[n : n + m] = b
            out[n + m :] = bound
            np.clip(out, -_INFINITY, _INFINITY, out=out)
        if self._model is None:
            self._model = daqp.Model()
            self._model.settings = {"primal_tol": 1.0e-8, "eps_prox": 0.0}
            flag, _ = self._model.setup(problem.H, problem.g, self._A, self._upper, self._lower, self._sense)
        else:
            flag = self._model.update(H=problem.H, f=problem.g, A=self._A, bupper=self._upper, blower=self._lower)
        if flag >= 0:
            x, _, flag, info = self._model.solve()
            iterations = int(info["iterations"])
            if flag == 1:
                return Answer(x, _STATUS[1], iterations, np.delete(info["lam"], slice(n, n + m)))
        else:
            iterations = 0
        self._model = None  # what is left of a failed solve must not start the next one
        return Answer(None, _STATUS.get(flag, f"exit flag {flag}"), iterations)
