"""Solvers by name, also those of qpsolvers."""

from collections.abc import Callable

import numpy as np
import qpsolvers

from wbc_controller.errors import require_known
from wbc_controller.inverse_dynamics.formulation.problem import Answer, QuadraticProgram
from wbc_controller.inverse_dynamics.solvers.daqp import DaqpSolver
from wbc_controller.inverse_dynamics.solvers.osqp import OsqpSolver
from wbc_controller.inverse_dynamics.solvers.proxqp import ProxqpSolver
from wbc_controller.inverse_dynamics.solvers.solver import Solver

_PERSISTENT: dict[str, Callable[[int, int, int], Solver]]
_PERSISTENT = {"daqp": DaqpSolver, "osqp": OsqpSolver, "proxqp": ProxqpSolver}


class ThroughQpsolvers(Solver):
    """Solver called through qpsolvers, set up in every cycle and therefore slow."""

    tolerance = 1.0e-3

    def __init__(self, name: str) -> None:
        self._name = name
        self._last: np.ndarray | None = None

    def _search(self, problem: QuadraticProgram) -> Answer:
        upper, lower = np.isfinite(problem.upper), np.isfinite(problem.lower)
        G = np.vstack([problem.C[upper], -problem.C[lower]])
        h = np.concatenate([problem.upper[upper], -problem.lower[lower]])
        qp = qpsolvers.Problem(problem.H, problem.g, G, h, problem.A, problem.b, problem.x_lower, problem.x_upper)
        try:
            solution = qpsolvers.solve_problem(qp, solver=self._name, initvals=self._last)
        except (qpsolvers.exceptions.QPError, ValueError, ArithmeticError) as error:
            # for infeasible problems
            return Answer(None, f"{type(error).__name__}: {error}", 0)
        # A solution marked as found may contain NaN.
        if not solution.found or solution.x is None or not np.isfinite(solution.x).all():
            return Answer(None, "no solution found", 0)
        self._last = np.array(solution.x)
        multipliers = np.zeros(problem.n + len(problem.upper))
        if solution.z_box is not None:
            multipliers[: problem.n] = solution.z_box
        if solution.z is not None:
            rows = multipliers[problem.n :]
            rows[upper] += solution.z[: upper.sum()]
            rows[lower] -= solution.z[upper.sum() :]
        return Answer(self._last, "optimal", 0, multipliers)


def available_solvers() -> list[str]:
    """Return the names of installed solvers."""
    return sorted({*_PERSISTENT, *qpsolvers.available_solvers})


def make_solver(name: str, problem: QuadraticProgram) -> Solver:
    """Make a solver for problems of the same size; raises `ConfigurationError` if the solver is not installed."""
    if name in _PERSISTENT:
        return _PERSISTENT[name](problem.n, len(problem.b), len(problem.upper))
    require_solver(name)
    return ThroughQpsolvers(name)


def require_solver(name: str) -> None:
    """Raise `ConfigurationError` if a solver is not installed."""
    require_known(name, available_solvers(), "solver.name =", ": the solver is not installed")
