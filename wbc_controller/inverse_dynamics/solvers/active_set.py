"""Warm start with the active set of the previous problem: the solution then takes one linear solve."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.linalg.lapack import dgesv

from wbc_controller.inverse_dynamics.formulation.answer import Answer
from wbc_controller.inverse_dynamics.formulation.problem import QuadraticProgram, Residuals
from wbc_controller.inverse_dynamics.formulation.problem_kernels import LeastSquares
from wbc_controller.inverse_dynamics.solvers import active_set_kernels as kernel
from wbc_controller.records import Array

#: Largest number of rows of a cost, per unknown, for which the condensed system is faster than the whole one.
_MOST_ROWS = 1.25


class LevelMemory:
    """Arrays that the levels of one problem share, for `solve_condensed`; one level is a hierarchy of one.

    Attributes:
        rows: N and s of x_base = s - N z, then the equality constraints in terms of z, then the rows that the levels
            above keep, (m_eq + kept, n + 1 - base).
        above: number of these rows so far, without those of N; 0 before the first level.
        multipliers: of the bounds of x and the rows of C: those of the first level in which each is active.
        residuals: residuals of the constraints at the solution of the last level.
    """

    __slots__ = ("above", "multipliers", "residuals", "rows")

    def __init__(self, problem: QuadraticProgram, base: int, kept: int = 0) -> None:
        """Allocate the arrays.

        Args:
            problem: the problem.
            base: number of the base accelerations.
            kept: number of rows that all levels together keep.
        """
        self.rows = np.empty((len(problem.b) + kept, problem.n + 1 - base))
        self.above = 0
        self.multipliers = np.empty(problem.bounds.shape[1])
        self.residuals = Residuals(problem)


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

    Usually the system can be condensed. The cost is then ½ Σ wᵢ (Rᵢ x - rᵢ)² + ½ Σ dᵢ (xᵢ - tᵢ)² (`LeastSquares`) with
    few rows R, and d > 0 except in the first k columns, the base accelerations. `solve_condensed` takes five steps:

    1. Eliminate the base: the last k equality constraints give x_base = s - N z, with z the remaining variables.
    2. Assemble the rows of R, of the other equality constraints and of W in terms of z: B = [A'; W'; R'] with
       right-hand sides β = [b'; w'; r']. With p = -[y; λ; w (R'z - r')] and E = 1 / w in the rows R', 0 elsewhere, the
       solution is

           z = t + D⁻¹ Bᵀp,    (B D⁻¹ Bᵀ + E) p = β - B t

    3. Factorize K = B D⁻¹ Bᵀ + E = UᵀU. It mostly has half as many rows as the whole system, and is positive definite.
    4. Solve for p and z. If weights differ much, digits are lost; two steps of iterative refinement restore them.
    5. Check the constraints and the signs of λ.

    For a level of strict priority (`hierarchy`), B also has the rows that the levels above keep.

    Attributes:
        side: of each bound of x and row of C, 1 if it is active at its upper bound, -1 at the lower one, else 0.
    """

    def __init__(self, n: int, equalities: int, inequalities: int) -> None:
        """Start with an empty active set."""
        self._n, self._m = n, equalities
        #: The active set, and the one that `solve_condensed` proposes after a wrong one.
        self._sides = np.zeros((2, n + inequalities), dtype=np.int8)
        self.side = self._sides[0]
        self._count = 0  # of active bounds

    def learn(self, multipliers: Array) -> None:
        """Adopt the active set of a solution from its multipliers, (n + m_in,) as in `Answer`."""
        self._take((multipliers > 0.0).astype(np.int8) - (multipliers < 0.0))

    def memory(self) -> dict[str, Any]:
        """Return the state for the next solution: the active set."""
        return {"side": self.side.copy()}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Restore the state that `memory` returned; one of a program with other constraints is ignored."""
        side = np.array(memory["side"], dtype=np.int8)
        if side.shape == self.side.shape:
            self._take(side)

    def _take(self, side: np.ndarray) -> None:
        self.side[:] = side
        self._count = int(np.count_nonzero(side))

    def solve(self, problem: QuadraticProgram) -> Answer | None:
        """Solve with the stored active set; None if it is not the active set of this problem."""
        if self._m + self._count > self._n:
            return None
        squares = problem.cost.squares
        if squares is None or len(squares.weights) > _MOST_ROWS * self._n:
            return self._full(problem)
        memory = LevelMemory(problem, squares.base)
        outcome, _, cost = self.solve_level(problem, squares, memory)
        if outcome != kernel.SOLVED:
            return None
        residuals = memory.residuals
        cost += problem.cost.squares_constant
        return Answer(residuals.value[: self._n], "optimal", 1, memory.multipliers, residuals, cost)

    def solve_level(
        self, problem: QuadraticProgram, squares: LeastSquares, memory: LevelMemory, kept: int = 0, tries: int = 1
    ) -> tuple[int, int, float]:
        """Solve the condensed system of a problem with the cost of a level.

        If the active set is wrong, the set of the violated constraints and of the multipliers with the right sign may
        be tried next: a primal-dual active set method (Hintermüller, Ito, Kunisch, "The primal-dual active set strategy
        as a semismooth Newton method", SIAM J. Optim. 13, 2002). It need not end, but mostly does at once.

        Args:
            problem: the problem.
            squares: the cost, under the constraints of the problem.
            memory: with the rows of the levels above; the solution is stored there.
            kept: number of rows of the cost that lower levels must not change.
            tries: largest number of active sets that are tried.

        Returns:
            The outcome of the last try (`active_set_kernels`), its number, and the sum of squares.
        """
        found, number = memory.residuals, 0
        while True:
            number += 1
            outcome, cost, found.least_room, found.largest_equality = kernel.solve_condensed(
                squares, self._sides, memory.rows, memory.above, kept, found.value,
                memory.multipliers, found.room, found.equalities, found.outputs,
            )  # fmt: skip
            if outcome != kernel.WRONG_SET or number == tries:
                break
            self._take(self._sides[1])
        if outcome == kernel.SOLVED:
            memory.above = (memory.above or len(problem.b) - squares.base) + kept
        return outcome, number, cost

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
        if info != 0 or not answer.dot(answer) <= kernel.LARGEST**2:
            return None
        residuals = problem.residuals(answer[:n])
        if not residuals.violation <= kernel.FEASIBLE or (self.side[active] * answer[m:] < 0.0).any():
            return None
        multipliers = np.zeros(len(self.side))
        multipliers[active] = answer[m:]
        # xᵀHx = -gᵀx - bᵀy - wᵀλ, the stationarity condition times xᵀ; and right is [-g; b; w].
        cost = problem.cost.constant - 0.5 * float(right @ answer)
        return Answer(answer[:n], "optimal", 1, multipliers, residuals, cost)
