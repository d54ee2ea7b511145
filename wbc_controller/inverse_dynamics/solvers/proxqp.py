"""ProxQP, an augmented-Lagrangian solver, dense back end: persistent, warm-started from the last solution."""

from typing import Any

import numpy as np
import proxsuite

from wbc_controller.inverse_dynamics.formulation.answer import Answer
from wbc_controller.inverse_dynamics.formulation.problem import QuadraticProgram
from wbc_controller.inverse_dynamics.solvers.solver import Solver

_proxqp = proxsuite.proxqp


class ProxqpSolver(Solver):
    """ProxQP.

    Source: Bambade, El-Kazdadi, Taylor, Carpentier, "PROX-QP: Yet another quadratic programming solver for robotics and
    beyond" (RSS 2022).
    """

    tolerance = 1.0e-5
    for_levels = False  # too many iterations for a fifth of random problems

    def __init__(self, n: int, equalities: int, inequalities: int) -> None:
        self._size = (n, equalities, inequalities)
        self._qp = self._make()
        self._started = False

    def _make(self) -> Any:
        n, equalities, inequalities = self._size
        qp = _proxqp.dense.QP(n, equalities, inequalities, True)
        # With 1e-7, internal forces between the feet, of low cost, were wrong by newtons after a warm start.
        qp.settings.eps_abs = 1.0e-8
        qp.settings.eps_rel = 0.0
        # An infeasible problem uses all iterations (inner times outer); feasible ones need about ten.
        qp.settings.max_iter = 50
        qp.settings.max_iter_in = 50
        # With the default 1e-4, feasible problems with a tight cone were reported as infeasible.
        qp.settings.eps_primal_inf = 1.0e-12
        qp.settings.initial_guess = _proxqp.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT
        return qp

    def _search(self, problem: QuadraticProgram) -> Answer:
        qp = self._qp
        data = (problem.H, problem.g, problem.A, problem.b, problem.C, problem.lower, problem.upper,
                problem.x_lower, problem.x_upper)  # fmt: skip
        if self._started:
            qp.update(*data, update_preconditioner=False)  # the magnitudes hardly change
        else:
            qp.init(*data)
            self._started = True
        qp.solve()
        info = qp.results.info
        if info.status == _proxqp.PROXQP_SOLVED:
            z, rows = np.array(qp.results.z), len(problem.upper)  # rows of C, then bounds of x
            return Answer(np.array(qp.results.x), "optimal", int(info.iter), np.concatenate([z[rows:], z[:rows]]))
        status = str(info.status).rsplit(".", 1)[-1].removeprefix("PROXQP_").replace("_", " ").lower()
        self._qp, self._started = self._make(), False
        return Answer(None, status, int(info.iter))
