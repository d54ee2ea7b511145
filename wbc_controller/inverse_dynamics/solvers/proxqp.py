"""ProxQP, an augmented-Lagrangian solver."""

from typing import Any

import numpy as np
import proxsuite

from wbc_controller.inverse_dynamics.formulation.problem import Answer, QuadraticProgram
from wbc_controller.inverse_dynamics.solvers.solver import Solver

_proxqp = proxsuite.proxqp


class ProxqpSolver(Solver):
    """ProxQP (Bambade, El-Kazdadi, Taylor, Carpentier, RSS 2022)."""

    tolerance = 1.0e-5
    for_levels = False  # too many iterations for random problems

    def __init__(self, n: int, equalities: int, inequalities: int) -> None:
        self._size = (n, equalities, inequalities)
        self._qp: Any = None

    def _search(self, problem: QuadraticProgram) -> Answer:
        constraints = problem.A, problem.b, problem.C, problem.lower, problem.upper
        data = (problem.H, problem.g, *constraints, problem.x_lower, problem.x_upper)
        qp = self._qp
        if qp is not None:
            qp.update(*data, update_preconditioner=False)  # similar magnitudes
        else:
            qp = self._qp = _proxqp.dense.QP(*self._size, True)
            # With 1e-7, internal forces between the feet were wrong by newtons after a warm start.
            qp.settings.eps_abs = 1.0e-8
            qp.settings.eps_rel = 0.0
            # Infeasible problems use all iterations; feasible ones need about ten.
            qp.settings.max_iter = qp.settings.max_iter_in = 50
            # The default 1e-4 causes false infeasibility with tight cones.
            qp.settings.eps_primal_inf = 1.0e-12
            qp.settings.initial_guess = _proxqp.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT
            qp.init(*data)
        qp.solve()
        info = qp.results.info
        if info.status == _proxqp.PROXQP_SOLVED:
            z, rows = np.array(qp.results.z), len(problem.upper)  # rows of C, then bounds of x
            return Answer(np.array(qp.results.x), "optimal", int(info.iter), np.concatenate([z[rows:], z[:rows]]))
        status = str(info.status).rsplit(".", 1)[-1].removeprefix("PROXQP_").replace("_", " ").lower()
        self._qp = None
        return Answer(None, status, int(info.iter))
