"""DAQP, a dual active-set solver."""

from collections.abc import Mapping

import daqp
import numpy as np

from wbc_controller.inverse_dynamics.formulation.problem import Answer, QuadraticProgram, SoftConstraints
from wbc_controller.inverse_dynamics.solvers.active_set import ActiveSet
from wbc_controller.inverse_dynamics.solvers.solver import Solver
from wbc_controller.records import Array

_ACTIVE, _LOWER, _EQUALITY, _SOFT = 1, 2, 5, 8  # kinds of constraints
_OPTIMAL = 1
_INFINITY = 1.0e30
#: Searches end within 1000 iterations, or cycle.
_SETTINGS: Mapping[str, float] = {"primal_tol": 1.0e-8, "eps_prox": 0.0, "iter_limit": 1500}
#: Settings after a failure: the default `sing_tol` of 4e-11 causes false infeasibility for ill-conditioned H.
#: Elimination of the equalities is faster, but fails on some problems.
_CAREFUL_SETTINGS: tuple[Mapping[str, float], ...] = (
    {**_SETTINGS, "iter_limit": 600, "sing_tol": 1.0e-13, "pivot_tol": 1.0e-2, "eq_reduction": 1},
    {**_SETTINGS, "iter_limit": 600, "sing_tol": 1.0e-13, "pivot_tol": 1.0e-2},
)
#: Last attempt: proximal-point iterations, for rare problems of lower levels.
_PROXIMAL_SETTINGS: Mapping[str, float] = {**_SETTINGS, "iter_limit": 600, "eps_prox": 0.1}
_WEIGHT_DIVISOR = 100.0  # of soft constraints without tasks, for convergence
INFEASIBLE = "infeasible"
_STATUS = {
    1: "optimal",
    2: "soft optimal",
    -1: "taken for infeasible",
    -2: "cycling",
    -3: "unbounded",
    -4: "iteration limit",
    -5: "nonconvex",
    -6: "overdetermined initial active set",
    -7: "time limit",
}


class DaqpSolver(Solver):
    """DAQP, called if the active set of the previous problem is wrong.

    Source: Arnström, Bemporad, Axehill, IEEE Transactions on Automatic Control, 2022.
    """

    tolerance = 1.0e-5

    def __init__(self, n: int, equalities: int, inequalities: int) -> None:
        self.active_set: ActiveSet = ActiveSet(n, equalities, inequalities)

    def _search(self, problem: QuadraticProgram) -> Answer:
        side, m = self.active_set.side, problem.bounds.shape[1]
        constraints = _constraints(problem)
        constraints[-1][:m] = _ACTIVE * (side != 0) + _LOWER * (side < 0)
        answer, _ = _attempt(problem, problem.H, problem.g, constraints, _SETTINGS)
        if answer.x is None:
            iterations, answer = answer.iterations, solve_carefully(problem)
            answer.iterations += iterations
        self.active_set.adopt_multipliers(np.zeros(m) if answer.x is None else answer.multipliers)
        return answer


def solve_carefully(problem: QuadraticProgram, soft: SoftConstraints | None = None) -> Answer:
    """Solve a problem on which DAQP may fail, without warm start.

    The feasible point nearest to 0 decides about feasibility; its active set starts the search. The multipliers of soft
    constraints are added to their places; x is None after a failure.
    """
    n, m = problem.n, problem.bounds.shape[1]
    rows, upper, lower, sense = _constraints(problem)
    end, iterations = len(sense), 0
    for settings in _CAREFUL_SETTINGS:
        answer, _ = _attempt(problem, np.eye(n), np.zeros(n), (rows, upper, lower, sense), settings)
        iterations += answer.iterations
        if answer.x is not None:
            break
    else:
        return Answer(None, INFEASIBLE, iterations)
    begin = np.array(sense)
    begin[:m] = _ACTIVE * (answer.multipliers != 0.0) + _LOWER * (answer.multipliers < 0.0)
    if soft is not None:
        rows = np.vstack([rows, problem.rows(soft.places)])
        lower, upper = np.hstack([[lower, upper], np.clip(soft.bounds, -_INFINITY, _INFINITY)])
        kind = np.full(len(soft.places), _SOFT, dtype=np.int32)
        sense, begin = np.concatenate([sense, kind]), np.concatenate([begin, kind])
        inverse_weights = np.concatenate([np.ones(end), 1.0 / soft.weights])
    attempts = [
        (problem.H, problem.g, first, settings, 1.0)
        for first, settings in zip((begin, sense, sense), (*_CAREFUL_SETTINGS, _PROXIMAL_SETTINGS), strict=True)
    ]
    if soft is not None:
        # One attempt: late torques are worse than a cycle without tasks.
        attempts = [attempts[0], (np.eye(n), np.zeros(n), begin, _CAREFUL_SETTINGS[0], _WEIGHT_DIVISOR)]
    for H, g, first, settings, lighter in attempts:
        compliance = None if soft is None else lighter * inverse_weights
        answer, multipliers = _attempt(problem, H, g, (rows, upper, lower, first), settings, compliance)
        iterations += answer.iterations
        if answer.x is not None:
            break
    if answer.x is not None and soft is not None:
        answer.multipliers = np.array(answer.multipliers)
        np.add.at(answer.multipliers, soft.places, multipliers[end:])
    answer.iterations = iterations
    return answer


_Constraints = tuple[Array, Array, Array, np.ndarray]  # rows, upper and lower bounds, kinds


def _constraints(problem: QuadraticProgram) -> _Constraints:
    """Return the constraints in DAQP's order: bounds of x, inequalities, equalities."""
    bounds = np.clip(np.hstack([problem.bounds, [problem.b, problem.b]]), -_INFINITY, _INFINITY)
    sense = np.zeros(bounds.shape[1], dtype=np.int32)
    sense[problem.bounds.shape[1] :] = _EQUALITY
    return np.vstack([problem.C, problem.A]), bounds[1], bounds[0], sense


def _attempt(
    problem: QuadraticProgram, H: Array, g: Array, constraints: _Constraints, settings: Mapping[str, float],
    compliance: Array | None = None,
) -> tuple[Answer, Array]:  # fmt: skip
    """Return a checked answer and all multipliers; `compliance` are the inverse weights of soft constraints."""
    x, iterations, multipliers, model = np.zeros(0), 0, np.zeros(0), daqp.Model()
    model.settings = settings
    flag, _ = model.setup(H, g, *constraints)
    if flag >= 0:
        if compliance is not None:
            model.soft_weights(rho_l=compliance, rho_u=compliance)
        x, _, flag, info = model.solve()
        iterations, multipliers = int(info["iterations"]), info["lam"]
    if flag < _OPTIMAL:
        return Answer(None, _STATUS.get(flag, f"exit flag {flag}"), iterations), multipliers
    residuals = problem.residuals(x)
    if not residuals.violation <= DaqpSolver.tolerance:
        return Answer(None, "inaccurate", iterations), multipliers
    own = multipliers[: problem.bounds.shape[1]]
    return Answer(x, _STATUS[_OPTIMAL], iterations, own, residuals), multipliers
