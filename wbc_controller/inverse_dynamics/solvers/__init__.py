"""Solvers of the quadratic program."""

from wbc_controller.inverse_dynamics.solvers.factory import available_solvers, make_solver
from wbc_controller.inverse_dynamics.solvers.solver import Solver

__all__ = ["Solver", "available_solvers", "make_solver"]
