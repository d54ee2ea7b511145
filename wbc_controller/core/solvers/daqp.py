"""DAQP, a dual active-set solver with a persistent workspace and warm start, after a first try by `ActiveSet`."""

from __future__ import annotations

import daqp
import numpy as np

from wbc_controller.core.program.problem import QuadraticProgram
from wbc_controller.core.solvers.active_set import ActiveSet
from wbc_controller.core.solvers.solver import Answer, Solver

_EQUALITY = 5
_OPTIMAL = 1
#: Weight of the proximal term in the second attempt.
_PROXIMAL = 1.0e-4
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
    """DAQP, called if the active set of the previous problem is not that of this one.

    From Arnström, Bemporad, Axehill, "A dual active-set solver for embedded quadratic programming using recursive LDLᵀ
    updates" (IEEE Transactions on Automatic Control, 2022).
    """

    tolerance = 1.0e-5

    def __init__(self, n: int, equalities: int, inequalities: int) -> None:
        rows = equalities + inequalities
        self._inequalities = n + inequalities  # the bounds of x come first
        self._rows = np.zeros((rows, n))
        self._upper = np.zeros(n + rows)
        self._lower = np.zeros(n + rows)
        self._sense = np.zeros(n + rows, dtype=np.int32)
        self._sense[n + inequalities :] = _EQUALITY
        self._active_set = ActiveSet(n, equalities, inequalities)
        self._model: daqp.Model | None = None

    def _guess(self, problem: QuadraticProgram) -> Answer | None:
        return self._active_set.solve(problem)

    def _search(self, problem: QuadraticProgram) -> Answer:
        m = self._inequalities
        self._rows[: len(problem.C)] = problem.C
        self._rows[len(problem.C) :] = problem.A
        for out, bound in ((self._lower, problem.bounds[0]), (self._upper, problem.bounds[1])):
            np.clip(bound, -_INFINITY, _INFINITY, out=out[:m])
            out[m:] = problem.b
        if self._model is None:
            self._model, flag = self._set_up(problem, 0.0)
        else:
            flag = self._model.update(H=problem.H, f=problem.g, A=self._rows, bupper=self._upper, blower=self._lower)
        x, flag, iterations, multipliers = self._run(self._model, flag)
        if flag != _OPTIMAL:
            # A failed solve must not warm-start the next one. And with an ill-conditioned H and a solution in a corner,
            # DAQP can report a feasible problem as infeasible; with proximal iterations it hardly ever does.
            self._model = None
            x, flag, more, multipliers = self._run(*self._set_up(problem, _PROXIMAL))
            iterations += more
        if flag == _OPTIMAL:
            self._active_set.learn(multipliers[:m])
            return Answer(x, _STATUS[flag], iterations, multipliers[:m])
        self._active_set.learn(np.zeros(m))
        return Answer(None, _STATUS.get(flag, f"exit flag {flag}"), iterations)

    def _set_up(self, problem: QuadraticProgram, proximal: float) -> tuple[daqp.Model, int]:
        model = daqp.Model()
        model.settings = {"primal_tol": 1.0e-8, "eps_prox": proximal}
        flag, _ = model.setup(problem.H, problem.g, self._rows, self._upper, self._lower, self._sense)
        return model, flag

    @staticmethod
    def _run(model: daqp.Model, flag: int) -> tuple[np.ndarray, int, int, np.ndarray]:
        """Minimizer, exit flag, iterations and multipliers; if the set-up has failed, the flag given."""
        if flag < 0:
            return np.zeros(0), flag, 0, np.zeros(0)
        x, _, flag, info = model.solve()
        return x, flag, int(info["iterations"]), info["lam"]
