"""Warm start with the active set of the previous problem: the solution then takes one linear solve."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.linalg.lapack import dgesv

from wbc_controller.compiled import Bound
from wbc_controller.inverse_dynamics.formulation.answer import Answer
from wbc_controller.inverse_dynamics.formulation.problem import QuadraticProgram, Residuals, Squares
from wbc_controller.inverse_dynamics.solvers import active_set_kernels as kernel
from wbc_controller.records import Array

#: Largest violation of a constraint, in the problem's units; the same as DAQP's tolerance.
_FEASIBLE = 1.0e-8
#: Largest residual of an equality constraint that the condensed system may leave without being refined.
_PRECISE = 1.0e-11
#: Largest norm of a solution before its linear system counts as nearly singular; 1e3 is usual.
_LARGEST = 1.0e8
#: The most rows of a cost, as a multiple of the unknowns, for which the condensed system is faster than the whole one.
_MOST_ROWS = 1.25


class ActiveSet:
    """Solves a quadratic program under the assumption that its active set is that of the previous problem.

    The active set hardly changes from one cycle to the next, and is often empty. If it is known, the solution follows
    from a linear system, with W the active rows of [I; C] and w their bounds,

        | H  Aᵀ  Wᵀ | | x |   | -g |
        | A  0   0  | | y | = |  b |
        | W  0   0  | | λ |   |  w |

    in a fraction of the time that a solver needs to search for the active set. x is the minimizer if and only if it
    meets all inequality constraints and no multiplier λ has the wrong sign. This is checked; if it fails, a solver
    searches.

    Usually the system can be condensed. The cost is then ½ Σ wᵢ (Rᵢ x - rᵢ)² + ½ Σ dᵢ (xᵢ - tᵢ)² (`Squares`) with few
    rows R, and d > 0 except in the first k columns, the base accelerations. These are eliminated by the last k equality
    constraints: x_k = s - N z, with z the remaining variables. In terms of z, the rows of R, of the other equality
    constraints and of W become B = [R'; A'; W'] with right-hand sides β = [r'; b'; w'], and with
    p = -[w (R'z - r'); y; λ]

        z = t + d⁻¹ Bᵀp,    (B d⁻¹ Bᵀ + E) p = β - B t

    where E is 1 / w on the diagonal for the rows R' and 0 elsewhere. This condensed system mostly has half as many
    unknowns, and is positive definite. Where weights differ much it loses digits, which two steps of iterative
    refinement bring back. For a level of strict priority (`hierarchy`), B also has the rows that the levels above keep.

    Attributes:
        side: of each bound of x and row of C, 1 if it is active at its upper bound, -1 at the lower one, else 0.
    """

    def __init__(self, n: int, equalities: int, inequalities: int) -> None:
        """Start with an empty active set."""
        self._n, self._m = n, equalities
        self._sides = np.zeros((2, n + inequalities), dtype=np.int8)  # and what compiled code proposes
        self.side = self._sides[0]
        self._count = 0  # of active ones
        self._total = n + inequalities
        self._work = np.zeros(0)
        self._bound_of: tuple[object, object, object] = (None, None, None)
        self._bound: Bound
        self._x = slice(n)

    def learn(self, multipliers: Array) -> None:
        """Take over the active set of a solution from its multipliers, (n + m_in,) as in `Answer`."""
        self._take((multipliers > 0.0).astype(np.int8) - (multipliers < 0.0))

    def memory(self) -> dict[str, Any]:
        """What it remembers: the active set."""
        return {"side": self.side.copy()}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Go on from what `memory` gave."""
        self._take(np.array(memory["side"], dtype=np.int8))

    def _take(self, side: np.ndarray) -> None:
        self.side[:] = side
        self._count = int(np.count_nonzero(side))

    def solve(self, problem: QuadraticProgram) -> Answer | None:
        """Solve with the stored active set; None if it is not the active set of this problem."""
        if self._m + self._count > self._n:
            return None
        squares, known = problem.cost.squares, self._bound_of
        if squares is None:
            return self._full(problem)
        if squares is known[0] and squares.inverse is known[1] and problem is known[2] and len(self._work):
            table = self._bound.table
        elif len(squares.slack) > _MOST_ROWS * self._n:
            return self._full(problem)
        else:
            table, self._work = self._table(problem, squares), work_memory(problem, squares, 0)
            self._space = 4 * self._total + self._m + len(problem.offset)  # for what the compiled code finds
        found = np.empty(self._space)
        outcome, cost, least, violation = kernel.condensed(table, squares.constant, self._work, 0, 0, found)
        if outcome != kernel.SOLVED:
            return None
        residuals = Residuals(found, self._total, self._m, least, violation)
        return Answer(found[self._x], "optimal", 1, None, residuals, cost)

    def condensed(
        self, problem: QuadraticProgram, squares: Squares, work: Array, count: int, kept: int, found: Array, tries: int
    ) -> tuple[int, int, float, float, float]:
        """Solve the condensed system of a problem with the cost of a level (`solvers.active_set_kernels`).

        Where the active set is wrong, that of the violated constraints and of the multipliers with the right sign may
        be tried next, which is a primal-dual active set method (Hintermüller, Ito, Kunisch, "The primal-dual active set
        strategy as a semismooth Newton method", SIAM J. Optim. 13, 2002). It need not end, but mostly does at once.

        Args:
            problem: whose constraints apply.
            squares: the cost.
            work: from `work_memory`.
            count: number of rows in it below those of the first level's elimination; 0 for the first level.
            kept: number of rows of the cost that are added to them.
            found: to be filled, as `Residuals` has it.
            tries: the most active sets that are tried.

        Returns:
            What came of the last one, its number, the cost, the smallest room, and the largest violation.
        """
        table, number = self._table(problem, squares), 0
        while True:
            number += 1
            outcome, cost, least, violation = kernel.condensed(table, squares.constant, work, count, kept, found)
            if outcome != kernel.WRONG_SET or number == tries:
                return outcome, number, cost, least, violation
            self._take(self._sides[1])

    def _table(self, problem: QuadraticProgram, squares: Squares) -> np.ndarray:
        """The arrays of a cost and of a problem, for compiled code."""
        known = self._bound_of
        if squares is not known[0] or squares.inverse is not known[1] or problem is not known[2]:
            self._bound_of = squares, squares.inverse, problem
            self._bound = bind(squares, problem, self._sides)
        return self._bound.table

    def _full(self, problem: QuadraticProgram) -> Answer | None:
        """Solve by the whole system; None if this is not the active set, or the system is singular or nearly so."""
        active, n, m = self.side.nonzero()[0], self._n, self._n + self._m
        size = m + len(active)
        K, right = np.zeros((size, size)), np.empty(size)
        K[:n, :n] = problem.H
        K[n:m, :n] = problem.A
        np.negative(problem.g, out=right[:n])
        right[n:m] = problem.b
        if len(active):
            K[m:, :n] = problem.rows(active)
            right[m:] = problem.bounds[(self.side[active] > 0).astype(np.intp), active]
        K[:n, n:] = K[n:, :n].T
        _, _, answer, info = dgesv(K.T, right, overwrite_a=True)  # K is symmetric: its transpose saves a copy
        if info != 0 or not answer.dot(answer) <= _LARGEST**2:
            return None
        residuals = problem.residuals(answer[:n])
        if not residuals.violation <= _FEASIBLE or (self.side[active] * answer[m:] < 0.0).any():
            return None
        multipliers = np.zeros(len(self.side))
        multipliers[active] = answer[m:]
        # xᵀHx = -gᵀx - bᵀy - wᵀλ, the stationarity condition times xᵀ; and right is [-g; b; w].
        cost = problem.cost.constant - 0.5 * float(right @ answer)
        return Answer(answer[:n], "optimal", 1, multipliers, residuals, cost)


def bind(
    squares: Squares,
    problem: QuadraticProgram,
    sides: np.ndarray,
    limits: tuple[float, float, float] = (_FEASIBLE, _PRECISE, _LARGEST),
) -> Bound:
    """The arrays of a cost, of a problem and of an active set, for `solvers.active_set_kernels.condensed`.

    Args:
        squares: the cost.
        problem: the problem.
        sides: of the active set, and memory for another one, (2, n + m_in).
        limits: largest violation of a constraint, residual that is not refined, and norm of a solution.
    """
    rows, equalities = problem.constraints, len(problem.b)
    return Bound(
        problem.n, len(squares.slack), squares.first, equalities, len(rows) - equalities, len(problem.offset),
        squares.stack, squares.slack, squares.inverse, squares.minus_target, rows, problem.bounds,
        sides, problem.offset, np.array(limits),
    )  # fmt: skip


def work_memory(problem: QuadraticProgram, squares: Squares, kept: int) -> Array:
    """What `solvers.active_set_kernels.condensed` works on from level to level, not filled.

    Args:
        problem: the problem.
        squares: the cost of its first level.
        kept: number of rows that all levels keep together.
    """
    return np.empty((len(problem.b) + kept) * (problem.n + 1 - squares.first))
