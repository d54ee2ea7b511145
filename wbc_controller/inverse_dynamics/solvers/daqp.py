"""DAQP, a dual active-set solver, warm-started with the active set of the last problem, after a first try with it."""

from collections.abc import Mapping
from typing import Any

import daqp
import numpy as np

from wbc_controller.inverse_dynamics.formulation.answer import Answer
from wbc_controller.inverse_dynamics.formulation.problem import QuadraticProgram, Residuals, Soft
from wbc_controller.inverse_dynamics.solvers.active_set import ActiveSet
from wbc_controller.inverse_dynamics.solvers.solver import Solver
from wbc_controller.records import Array

_ACTIVE = 1
_LOWER = 2
_EQUALITY = 5
_SOFT = 8
_OPTIMAL = 1
_INFINITY = 1.0e30
#: The most iterations seen in a search that ended is 1000; others cycle.
_SETTINGS: Mapping[str, float] = {"primal_tol": 1.0e-8, "eps_prox": 0.0, "iter_limit": 1500}
#: Settings for problems on which DAQP has failed. It calls a problem infeasible if a constraint depends on the active
#: ones but for less than `sing_tol`; its default of 4e-11 is too much where H is ill-conditioned. Below `pivot_tol` it
#: refines the solution. With the equalities eliminated it is faster; without, it solves some of the others.
_CAREFUL: tuple[Mapping[str, float], ...] = (
    {**_SETTINGS, "iter_limit": 600, "sing_tol": 1.0e-13, "pivot_tol": 1.0e-2, "eq_reduction": 1},
    {**_SETTINGS, "iter_limit": 600, "sing_tol": 1.0e-13, "pivot_tol": 1.0e-2},
)
#: The last attempt: proximal-point iterations, which factorize H + eps_prox 1 in place of H. They have solved all of 5
#: problems in 12,000 of lower levels that DAQP takes for infeasible even with the settings above.
_PROXIMAL: Mapping[str, float] = {**_SETTINGS, "iter_limit": 600, "eps_prox": 0.1}
#: By what the weights of soft constraints are divided where no task is pursued: DAQP ends on more such problems.
_LIGHTER = 100.0
#: Status of a problem whose constraints cannot be met together; that of other failures is different.
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
    """DAQP, called if the active set of the previous problem is not that of this one.

    It begins with that active set, which is all that it remembers: a recording that has it can be solved again, bit for
    bit. A workspace that is kept would be no faster, as every matrix is another one in every cycle.

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
        self.active_set: ActiveSet = ActiveSet(n, equalities, inequalities)

    def memory(self) -> dict[str, Any] | None:
        """What it remembers of the last problem: its active set."""
        return self.active_set.memory()

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Go on from what `memory` gave."""
        self.active_set.recall(memory)

    def _search(self, problem: QuadraticProgram) -> Answer:
        m = self._inequalities
        self._rows[: len(problem.C)] = problem.C
        self._rows[len(problem.C) :] = problem.A
        for out, bound in ((self._lower, problem.bounds[0]), (self._upper, problem.bounds[1])):
            np.clip(bound, -_INFINITY, _INFINITY, out=out[:m])
            out[m:] = problem.b
        side = self.active_set.side
        self._sense[:m] = _ACTIVE * (side != 0) + _LOWER * (side < 0)
        constraints = self._rows, self._upper, self._lower, self._sense
        answer = _checked(problem, *_run(*_set_up(problem.H, problem.g, constraints, _SETTINGS)))
        if answer.x is None:
            iterations, answer = answer.iterations, solve_carefully(problem)
            answer.iterations += iterations
        self.active_set.learn(np.zeros(m) if answer.x is None else answer.multipliers)
        return answer


def solve_carefully(problem: QuadraticProgram, soft: Soft | None = None) -> Answer:
    """Solve a problem on which DAQP may fail, without warm start.

    The point of the feasible set nearest to 0 decides whether the problem is feasible: DAQP finds it fast and reliably,
    as it does not depend on H. The search for the minimizer begins with its active set, and if it fails with none.

    Returns:
        The minimizer, where a soft constraint's multiplier adds to that of the same place. Without x if there is none,
        and with the status `INFEASIBLE` if the constraints cannot be met together.
    """
    n, m = problem.n, problem.bounds.shape[1]
    end = m + len(problem.b)
    rows = np.vstack([problem.C, problem.A])
    lower, upper = np.clip(np.hstack([problem.bounds, [problem.b, problem.b]]), -_INFINITY, _INFINITY)
    sense = np.zeros(end, dtype=np.int32)
    sense[m:] = _EQUALITY
    iterations = 0
    for settings in _CAREFUL:
        x, flag, used, multipliers = _run(*_set_up(np.eye(n), np.zeros(n), (rows, upper, lower, sense), settings))
        answer = _checked(problem, x, flag, used, multipliers)
        iterations += used
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
        for first, settings in zip((begin, sense, sense), (*_CAREFUL, _PROXIMAL), strict=True)
    ]
    if soft is not None:
        # One attempt: torques that come some periods late are worse than a cycle in which little is missed and no task
        # is pursued.
        attempts = [attempts[0], (np.eye(n), np.zeros(n), begin, _CAREFUL[0], _LIGHTER)]
    for H, g, first, settings, lighter in attempts:
        model, flag = _set_up(H, g, (rows, upper, lower, first), settings)
        if soft is not None and flag >= 0:
            model.soft_weights(rho_l=lighter * inverse_weights, rho_u=lighter * inverse_weights)
        x, flag, used, multipliers = _run(model, flag)
        answer = _checked(problem, x, flag, used, multipliers)
        iterations += used
        if answer.x is not None:
            break
    if answer.x is not None and soft is not None:
        answer.multipliers = np.array(answer.multipliers)
        np.add.at(answer.multipliers, soft.places, multipliers[end:])
    answer.iterations = iterations
    return answer


_Constraints = tuple[Array, Array, Array, np.ndarray]


def _set_up(H: Array, g: Array, constraints: _Constraints, settings: Mapping[str, float]) -> tuple[daqp.Model, int]:
    """A new model of ½ xᵀHx + gᵀx with rows, upper and lower bounds and kinds of constraints, and its exit flag."""
    model = daqp.Model()
    model.settings = settings
    flag, _ = model.setup(H, g, *constraints)
    return model, flag


def _run(model: daqp.Model, flag: int) -> tuple[Array, int, int, Array]:
    """Minimizer, exit flag, iterations and multipliers; if the set-up has failed, the flag given."""
    if flag < 0:
        return np.zeros(0), flag, 0, np.zeros(0)
    x, _, flag, info = model.solve()
    return x, flag, int(info["iterations"]), info["lam"]


def _checked(problem: QuadraticProgram, x: Array, flag: int, iterations: int, multipliers: Array) -> Answer:
    """The answer of a run of DAQP; without x if it violates a constraint."""
    if flag < _OPTIMAL:
        return Answer(None, _STATUS.get(flag, f"exit flag {flag}"), iterations)
    residuals: Residuals = problem.residuals(x)
    if not residuals.violation <= DaqpSolver.tolerance:
        return Answer(None, "inaccurate", iterations)
    return Answer(x, _STATUS[_OPTIMAL], iterations, multipliers[: problem.bounds.shape[1]], residuals)
