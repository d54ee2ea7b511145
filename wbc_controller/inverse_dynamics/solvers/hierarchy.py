"""Strict priorities: one quadratic program per level."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.linalg import qr

from wbc_controller.inverse_dynamics.formulation.problem import NOT_FINITE, Answer, Level, QuadraticProgram
from wbc_controller.inverse_dynamics.solvers import Solver
from wbc_controller.inverse_dynamics.solvers import active_set_kernels as kernel
from wbc_controller.inverse_dynamics.solvers.active_set import ActiveSet, LevelWorkspace
from wbc_controller.inverse_dynamics.solvers.least_distance import solve_by_least_distance
from wbc_controller.records import Array, LevelReport

_RANK = 1.0e-9  # relative size of dependent rows
_CLEARANCE = 1.0e-7  # at binding constraints, so that z = 0 is feasible below
_CONSISTENT = 1.0e-6  # violation of the equalities
_TRIES = 4  # per level
_MOST_SKIPS = 15  # after failures


class Hierarchy:
    """Strict priorities: levels solved in sequence, so that no level worsens one above it.

    After Kanoun, Lamiraux, Wieber (T-RO 27, 2011), with null spaces as in Escande, Mansard and Wieber (IJRR 33, 2014).
    With a basis N of the null space of A x = b and of the levels above, level k minimizes over z and s

        ½ xᵀHx + gᵀx + ½ ‖s‖²,    x = x_above + N z,    lower ≤ G x + s ≤ upper

    subject to the inequality constraints. Then its rows reduce N, and its rows with a tolerance become inequality
    constraints, widened by the slack s.

    Without tolerances and effort tasks, the last active sets are tried first (`ActiveSet`).
    """

    def __init__(self, make_solver: Callable[[QuadraticProgram], Solver], timer: Callable[[], float]) -> None:
        self._make_solver = make_solver
        self._timer = timer
        self._solvers: dict[tuple[int, int, int], Solver] = {}
        self._active_sets: list[ActiveSet] = []
        self._misses, self._skips_left = 0, 0

    def memory(self) -> dict[str, Any] | None:
        """Return active sets, counters and solver states for `recall`; None if a solver hides its warm start."""
        solvers = [(size, solver.memory()) for size, solver in self._solvers.items()]
        if any(remembered is None for _, remembered in solvers):
            return None
        active_sets = [active_set.memory() for active_set in self._active_sets]
        return {"solvers": solvers, "active_sets": active_sets, "misses": self._misses, "rest": self._skips_left}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Restore the result of `memory`."""
        self._solvers.clear()
        for (index, n, inequalities), remembered in memory["solvers"]:
            solver = self._make_solver(QuadraticProgram.empty(n, 0, inequalities))
            solver.recall(remembered)
            self._solvers[index, n, inequalities] = solver
        self._active_sets.clear()
        for remembered in memory["active_sets"]:
            active_set = ActiveSet(len(remembered["side"]), 0, 0)
            active_set.recall(remembered)
            self._active_sets.append(active_set)
        self._misses, self._skips_left = memory["misses"], memory["rest"]

    def solve(self, problem: QuadraticProgram, levels: Sequence[Level]) -> Answer:
        """Solve all levels under the constraints of a problem.

        The multipliers are from the first level in which a constraint binds; x is None if the first level fails;
        `relaxed` names a failed lower level.
        """
        answer = self._solve_warm(problem, levels)
        if answer is None:
            answer = self._search(problem, levels) if problem.is_finite else Answer(None, NOT_FINITE, 0)
        return answer

    def _solve_warm(self, problem: QuadraticProgram, levels: Sequence[Level]) -> Answer | None:
        """Solve with the active sets of the last problem; None after a failure, or while skipped."""
        if self._skips_left:
            self._skips_left -= 1
            return None
        costs = [level.cost.squares for level in levels if level.cost.squares is not None and not len(level.G)]
        if len(costs) != len(levels) or len(problem.b) >= problem.n:
            return None
        size = problem.n + len(problem.upper)
        if [len(each.side) for each in self._active_sets] != [size] * len(levels):
            self._active_sets = [ActiveSet(problem.n, len(problem.b), len(problem.upper)) for _ in levels]
        kept = sum(len(level.kept) for level in levels)
        memory, iterations, reports = LevelWorkspace(problem, costs[0].base, kept), 0, []
        for level, squares, active_set in zip(levels, costs, self._active_sets, strict=True):
            if not level.tasks and level is not levels[-1]:
                continue
            started = self._timer()
            outcome, number, cost = active_set.solve_level(problem, squares, memory, len(level.kept), _TRIES)
            if outcome == kernel.NOTHING_FREE:
                break
            if outcome != kernel.SOLVED:
                self._misses += 1
                self._skips_left = min(2 ** (self._misses - 1) - 1, _MOST_SKIPS)
                return None
            iterations += number
            cost += level.cost.squares_constant
            reports.append(LevelReport(level.tasks, cost, number, self._timer() - started))
        self._misses = 0
        residuals = memory.residuals
        return Answer(
            residuals.value[: problem.n], "optimal", iterations, memory.multipliers, residuals, levels=tuple(reports)
        )

    def _search(self, problem: QuadraticProgram, levels: Sequence[Level]) -> Answer:
        n, (Q, R, order, rank) = problem.n, _pivoted_qr(problem.A)
        # A[order] = (Q R)ᵀ: with x = Q[:, :rank] y, the first `rank` rows are R₁ᵀ y = b.
        y = np.linalg.solve(R[:rank, :rank].T, problem.b[order[:rank]]) if rank else np.zeros(0)
        x, free = Q[:, :rank] @ y, Q[:, rank:]
        if not (np.max(np.abs(problem.A @ x - problem.b), initial=0.0) <= _CONSISTENT):
            return Answer(None, "the equalities contradict each other", 0)
        rows = np.vstack([np.eye(n), problem.C])
        lower, upper = problem.bounds
        solved = Answer(x, "optimal", 0, np.zeros(len(rows)))
        self._active_sets = [ActiveSet(n, len(problem.b), len(problem.upper)) for _ in levels]
        for index, level in enumerate(levels):
            last = index == len(levels) - 1
            if not (level.tasks or last) or free.shape[1] + len(level.G) == 0:
                continue
            started = self._timer()
            reduced = _reduced_problem(level, x, free, rows, lower, upper, widened=bool(solved.levels))
            size = (index, len(reduced.g), len(reduced.upper))
            if size not in self._solvers:
                self._solvers[size] = self._make_solver(reduced)
            answer = self._solvers[size].solve(reduced)
            solved.iterations += answer.iterations
            tolerance = self._solvers[size].tolerance
            if solved.levels and (answer.x is None or not (reduced.residuals(answer.x).violation <= tolerance)):
                status, answer = answer.status, solve_by_least_distance(reduced)
                answer.status = f"{status}; {answer.status}"
            found = answer.x
            if found is None or not (reduced.residuals(found).violation <= tolerance):
                if not solved.levels:
                    return Answer(None, answer.status, solved.iterations)
                solved.relaxed += (f"level with {', '.join(level.tasks)}: {answer.status}",)
                found, answer.multipliers = _least_slack(reduced, free.shape[1]), np.zeros(reduced.bounds.shape[1])
            z, slack = np.split(found, [free.shape[1]])
            x = solved.x = x + free @ z
            # The first rows of the reduced problem are the bounds and rows of the problem.
            costs = answer.multipliers[len(reduced.g) :][: len(solved.multipliers)]
            self._active_sets[index].adopt_multipliers(costs)
            solved.multipliers = np.where(solved.multipliers == 0.0, costs, solved.multipliers)
            value = level.G @ x
            rows = np.vstack([rows, level.G])
            lower = np.concatenate([lower, np.minimum(level.lower, value)])
            upper = np.concatenate([upper, np.maximum(level.upper, value)])
            cost = level.cost.value(x) + 0.5 * float(slack @ slack)
            solved.levels += (LevelReport(level.tasks, cost, answer.iterations, self._timer() - started),)
            if not last:
                directions, _, _, rank = _pivoted_qr(level.kept @ free)
                free = free @ directions[:, rank:]
        return solved


def _least_slack(reduced: QuadraticProgram, nz: int) -> Array:
    """Return [z, s] with z = 0 and the least s, (n,), feasible in all lower levels."""
    first = len(reduced.upper) - (reduced.n - nz)
    return np.concatenate([np.zeros(nz), np.clip(0.0, reduced.lower[first:], reduced.upper[first:])])


def _reduced_problem(
    level: Level, x: Array, free: Array, rows: Array, lower: Array, upper: Array, *, widened: bool
) -> QuadraticProgram:
    """Return one level in the variables [z, s]; if `widened`, z = 0 is feasible in spite of rounding."""
    nz, ns, m = free.shape[1], len(level.G), len(rows)
    reduced = QuadraticProgram.empty(nz + ns, 0, m + ns)
    H = free.T @ level.cost.H @ free
    reduced.H[:nz, :nz] = 0.5 * (H + H.T)
    reduced.H[nz:, nz:] = np.eye(ns)
    reduced.g[:nz] = free.T @ (level.cost.g + level.cost.H @ x)
    reduced.C[:m, :nz] = rows @ free
    value = rows @ x
    reduced.lower[:m], reduced.upper[:m] = lower - value, upper - value
    if widened:
        np.minimum(reduced.lower[:m], -_CLEARANCE, out=reduced.lower[:m])
        np.maximum(reduced.upper[:m], _CLEARANCE, out=reduced.upper[:m])
        decided = np.linalg.norm(reduced.C[:m], axis=1) <= _RANK * np.maximum(1.0, np.linalg.norm(rows, axis=1))
        reduced.lower[:m][decided], reduced.upper[:m][decided] = -np.inf, np.inf  # independent of z
    value = level.G @ x
    reduced.C[m:, :nz] = level.G @ free
    reduced.C[m:, nz:] = np.eye(ns)
    reduced.lower[m:], reduced.upper[m:] = level.lower - value, level.upper - value
    return reduced


def _pivoted_qr(A: Array) -> tuple[Array, Array, np.ndarray, int]:
    if not A.size:
        return np.eye(A.shape[1]), np.zeros((A.shape[1], 0)), np.zeros(0, dtype=np.intp), 0
    Q, R, order = qr(A.T, pivoting=True)
    size = np.abs(np.diagonal(R))
    return Q, R, order, int(np.sum(size > _RANK * max(1.0, float(size[0]))))
