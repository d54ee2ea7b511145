"""Strict priorities: one quadratic program per level, each in the null space of the levels above."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.linalg import qr

from wbc_controller.inverse_dynamics.formulation.answer import NOT_FINITE, Answer
from wbc_controller.inverse_dynamics.formulation.problem import Level, QuadraticProgram
from wbc_controller.inverse_dynamics.formulation.problem_kernels import LeastSquares
from wbc_controller.inverse_dynamics.solvers import Solver
from wbc_controller.inverse_dynamics.solvers import active_set_kernels as kernel
from wbc_controller.inverse_dynamics.solvers.active_set import ActiveSet, LevelMemory
from wbc_controller.records import Array, LevelReport

#: Rows count as linearly dependent below this share of the largest.
_RANK = 1.0e-9
#: Room that a level leaves at a binding constraint, in the problem's units, so that z = 0 is feasible below.
_ROOM = 1.0e-7
#: Largest violation of the equalities by their own least-squares solution, in the problem's units.
_CONSISTENT = 1.0e-6
#: The most active sets that are tried for a level: the last one, and what follows from it. More hardly ever succeed.
_TRIES = 4
#: The most problems in a row that are not tried with the active sets of the last one, after these have failed often.
_LONGEST_REST = 15


class Hierarchy:
    """Solves levels one after the other, so that no level worsens one above it.

    After Kanoun, Lamiraux, Wieber, "Kinematic control of redundant manipulators: generalizing the task-priority
    framework to inequality tasks" (T-RO 27, 2011), with null spaces in place of equality constraints, as in Escande,
    Mansard and Wieber, "Hierarchical quadratic programming" (IJRR 33, 2014). With N a basis of the null space of the
    equality constraints A x = b and of the levels above, level k minimizes over z and s

        ½ xᵀHx + gᵀx + ½ ‖s‖²,    x = x_above + N z,    lower ≤ G x + s ≤ upper

    subject to the inequality constraints of the problem. After that N is reduced to the null space of its rows too, and
    its rows with a tolerance become inequality constraints, widened by the slack s.

    Before that, all levels are tried with their active sets of the last problem, as in `ActiveSet`: where these are
    still right, or nearly, a level is one linear system or a few, without null space and without search. What the rows
    of the levels above have reached are equality constraints of it. This takes costs that are squares: no tolerances,
    and no tasks on forces or torques.
    """

    def __init__(self, make_solver: Callable[[QuadraticProgram], Solver], timer: Callable[[], float]) -> None:
        """Make a hierarchy.

        Args:
            make_solver: makes a solver for problems of the same size as the one given.
        """
        self._make_solver = make_solver
        self._timer = timer
        self._solvers: dict[tuple[int, int, int], Solver] = {}
        self._active_sets: list[ActiveSet] = []
        self._misses, self._rest = 0, 0

    def memory(self) -> dict[str, Any] | None:
        """All that the next solution depends on.

        Returns:
            The active set of each level, how often they were wrong in a row, and for how many problems they are not
            tried; and what the solver of each level remembers, by its index and the size of its problem. None where a
            solver keeps its warm start to itself (`Solver.memory`).
        """
        solvers = [(size, solver.memory()) for size, solver in self._solvers.items()]
        if any(remembered is None for _, remembered in solvers):
            return None
        active_sets = [active_set.memory() for active_set in self._active_sets]
        return {"solvers": solvers, "active_sets": active_sets, "misses": self._misses, "rest": self._rest}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Go on from what `memory` gave."""
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
        self._misses, self._rest = memory["misses"], memory["rest"]

    def solve(self, problem: QuadraticProgram, levels: Sequence[Level]) -> Answer:
        """Solve all levels.

        Args:
            problem: the problem whose constraints apply to all levels.

        Returns:
            The solution in the problem's decision variables. The multiplier of each constraint is that of the first
            level in which it is binding. If the first level has no solution, x is None, as from a solver. Where the
            solver of a lower level fails, the solution of the others is used, and `relaxed` has a sentence on it.
        """
        answer = self._guess(problem, levels)
        if answer is not None:
            return answer
        if not problem.is_finite:
            return Answer(None, NOT_FINITE, 0)
        return self._search(problem, levels)

    def _guess(self, problem: QuadraticProgram, levels: Sequence[Level]) -> Answer | None:
        """Solve, beginning with the active sets of the last problem; None where this fails, or is not tried."""
        if self._rest:
            self._rest -= 1
            return None
        costs: list[LeastSquares] = []
        for level in levels:
            if level.cost.squares is None or len(level.G):
                return None
            costs.append(level.cost.squares)
        if len(problem.b) >= problem.n:
            return None
        size = problem.n + len(problem.upper)
        if [len(each.side) for each in self._active_sets] != [size] * len(levels):
            self._active_sets = [ActiveSet(problem.n, len(problem.b), len(problem.upper)) for _ in levels]
        kept = sum(len(level.kept) for level in levels)
        memory, iterations, reports = LevelMemory(problem, costs[0].base, kept), 0, []
        for level, squares, active_set in zip(levels, costs, self._active_sets, strict=True):
            if not level.tasks and level is not levels[-1]:
                continue
            started = self._timer()
            outcome, number, cost = active_set.solve_level(problem, squares, memory, len(level.kept), _TRIES)
            if outcome == kernel.NOTHING_FREE:
                break
            if outcome != kernel.SOLVED:
                self._misses += 1
                self._rest = min(2 ** (self._misses - 1) - 1, _LONGEST_REST)
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
        """Solve each level in the null space of those above, and learn the active sets."""
        n = problem.n
        x, free = _solution_and_null_space(problem.A, problem.b)
        if not (np.max(np.abs(problem.A @ x - problem.b), initial=0.0) <= _CONSISTENT):
            return Answer(None, "the equalities contradict each other", 0)
        rows = np.vstack([np.eye(n), problem.C])
        lower = np.concatenate([problem.x_lower, problem.lower])
        upper = np.concatenate([problem.x_upper, problem.upper])
        multipliers = np.zeros(len(rows))
        iterations = 0
        reports: tuple[LevelReport, ...] = ()
        unsolved: tuple[str, ...] = ()
        self._active_sets = [ActiveSet(n, len(problem.b), len(problem.upper)) for _ in levels]
        for index, level in enumerate(levels):
            last = index == len(levels) - 1
            if not (level.tasks or last) or free.shape[1] + len(level.G) == 0:
                continue
            started = self._timer()
            reduced = _reduced(level, x, free, rows, lower, upper, widened=bool(reports))
            size = (index, len(reduced.g), len(reduced.upper))
            if size not in self._solvers:
                self._solvers[size] = self._make_solver(reduced)
            answer = self._solvers[size].solve(reduced)
            iterations += answer.iterations
            if answer.x is None or not (reduced.violation(answer.x) <= self._solvers[size].tolerance):
                if not reports:
                    return Answer(None, answer.status, iterations)
                unsolved += (f"level with {', '.join(level.tasks)}: {answer.status}",)
                continue
            z, slack = np.split(answer.x, [free.shape[1]])
            x = x + free @ z
            # The reduced problem has no bounds on its variables; its first rows are the bounds and rows of the problem.
            costs = answer.multipliers[len(reduced.g) :][: len(multipliers)]
            self._active_sets[index].learn(costs)
            multipliers = np.where(multipliers == 0.0, costs, multipliers)
            value = level.G @ x
            rows = np.vstack([rows, level.G])
            lower = np.concatenate([lower, np.minimum(level.lower, value)])
            upper = np.concatenate([upper, np.maximum(level.upper, value)])
            cost = level.cost.value(x) + 0.5 * float(slack @ slack)
            reports += (LevelReport(level.tasks, cost, answer.iterations, self._timer() - started),)
            if not last:
                free = free @ _null_space(level.kept @ free)
        solved = Answer(x, "optimal", iterations, multipliers)
        solved.levels, solved.relaxed = reports, unsolved
        return solved


def _reduced(
    level: Level, x: Array, free: Array, rows: Array, lower: Array, upper: Array, *, widened: bool
) -> QuadraticProgram:
    """One level in the variables [z, s]; if widened, z = 0 is feasible in spite of rounding in the levels above."""
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
        np.minimum(reduced.lower[:m], -_ROOM, out=reduced.lower[:m])
        np.maximum(reduced.upper[:m], _ROOM, out=reduced.upper[:m])
        decided = np.linalg.norm(reduced.C[:m], axis=1) <= _RANK * np.maximum(1.0, np.linalg.norm(rows, axis=1))
        reduced.lower[:m][decided], reduced.upper[:m][decided] = -np.inf, np.inf  # z does not affect these rows
    value = level.G @ x
    reduced.C[m:, :nz] = level.G @ free
    reduced.C[m:, nz:] = np.eye(ns)
    reduced.lower[m:], reduced.upper[m:] = level.lower - value, level.upper - value
    return reduced


def _solution_and_null_space(A: Array, b: Array) -> tuple[Array, Array]:
    """The smallest x with A x = b, from a maximal set of independent rows, and a basis of A's null space."""
    Q, R, order, rank = _factors(A)
    # A[order] = (Q R)ᵀ: with x = Q[:, :rank] y, the first `rank` rows, which are independent, read R₁ᵀ y = b.
    y = np.linalg.solve(R[:rank, :rank].T, b[order[:rank]]) if rank else np.zeros(0)
    return Q[:, :rank] @ y, Q[:, rank:]


def _null_space(A: Array) -> Array:
    """Orthonormal basis of the null space of A, (n, n - rank)."""
    Q, _, _, rank = _factors(A)
    return Q[:, rank:]


def _factors(A: Array) -> tuple[Array, Array, np.ndarray, int]:
    """QR decomposition of Aᵀ with column pivoting, and A's rank."""
    if not A.size:
        return np.eye(A.shape[1]), np.zeros((A.shape[1], 0)), np.zeros(0, dtype=np.intp), 0
    Q, R, order = qr(A.T, pivoting=True)
    size = np.abs(np.diagonal(R))
    return Q, R, order, int(np.sum(size > _RANK * max(1.0, float(size[0]))))
