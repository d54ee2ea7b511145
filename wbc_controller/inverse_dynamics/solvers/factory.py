"""Solvers by name."""

from collections.abc import Callable

import qpsolvers

from wbc_controller.errors import require_known
from wbc_controller.inverse_dynamics.formulation.problem import QuadraticProgram
from wbc_controller.inverse_dynamics.solvers.daqp import DaqpSolver
from wbc_controller.inverse_dynamics.solvers.osqp import OsqpSolver
from wbc_controller.inverse_dynamics.solvers.proxqp import ProxqpSolver
from wbc_controller.inverse_dynamics.solvers.solver import Solver
from wbc_controller.inverse_dynamics.solvers.through_qpsolvers import ThroughQpsolvers

_PERSISTENT: dict[str, Callable[[int, int, int], Solver]] = {
    "daqp": DaqpSolver,
    "osqp": OsqpSolver,
    "proxqp": ProxqpSolver,
}


def available_solvers() -> list[str]:
    """Return the names of installed solvers."""
    return sorted({*_PERSISTENT, *qpsolvers.available_solvers})


def make_solver(name: str, problem: QuadraticProgram) -> Solver:
    """Make a solver for problems of the same size.

    Raises:
        ConfigurationError: if the solver is not installed.
    """
    if name in _PERSISTENT:
        return _PERSISTENT[name](problem.n, len(problem.b), len(problem.upper))
    require_solver(name)
    return ThroughQpsolvers(name)


def require_solver(name: str) -> None:
    """Raise `ConfigurationError` if a solver is not installed."""
    require_known(name, available_solvers(), "solver.name =", ": the solver is not installed")
