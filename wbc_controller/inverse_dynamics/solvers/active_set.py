"""Warm start with the previous active set."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.linalg.lapack import dgesv

from wbc_controller.inverse_dynamics.formulation.problem import Answer, QuadraticProgram, Residuals
from wbc_controller.inverse_dynamics.formulation.problem_kernels import LeastSquares
from wbc_controller.inverse_dynamics.solvers import active_set_kernels as kernel
from wbc_controller.records import Array

_MOST_ROWS = 1.25  # cost rows per unknown, for the condensed system
_TRIES = 8  # active sets per problem before a solver searches, which takes longer


class LevelWorkspace:
    """Arrays shared by the levels of one problem, for `solve_condensed`."""

    __slots__ = ("above", "multipliers", "residuals", "rows")

    def __init__(self, problem: QuadraticProgram, base: int, kept: int = 0) -> None:
        """Allocate arrays for `base` accelerations, and `kept` rows of all levels."""
        #: N and s of x_base = s - N z, equality constraints in terms of z, and kept rows of the levels above.
        self.rows = np.empty((len(problem.b) + kept, problem.n + 1 - base))
        self.above = 0  # number of rows without N
        #: Of the bounds of [x; C x], from the first level in which each is active.
        self.multipliers = np.empty(problem.bounds.shape[1])
        self.residuals = Residuals(problem)


class ActiveSet:
    """Solution of a quadratic program with the active set of the previous problem.

    With the active rows W of [I; C] and their bounds w, the solution follows from a linear system:

        | H  Aᵀ  Wᵀ | | x |   | -g |
        | A  0   0  | | y | = |  b |
        | W  0   0  | | λ |   |  w |

    x is the minimizer if and only if it meets all inequality constraints and no multiplier λ has the wrong sign.

    Usually the system can be condensed: the cost is ½ Σ wᵢ (Rᵢ x - rᵢ)² + ½ Σ dᵢ (xᵢ - tᵢ)² (`LeastSquares`) with few
    rows R, and d > 0 except for the k base accelerations. `solve_condensed`:

    1. Eliminate the base: the last k equality constraints give x_base = s - N z with the other variables z.
    2. Assemble R, the other equality constraints and W in terms of z: B = [A'; W'; R'], β = [b'; w'; r']. With p = -[y;
      λ; w (R'z - r')] and E = 1 / w in the rows R', 0 elsewhere,

           z = t + D⁻¹ Bᵀp,    (B D⁻¹ Bᵀ + E) p = β - B t

    3. Factorize K = B D⁻¹ Bᵀ + E = UᵀU.
    4. Solve for p and z, with iterative refinement.
    5. Check the constraints and the signs of λ.

    For a level of strict priority (`hierarchy`), B also has the kept rows of the levels above.
    """

    def __init__(self, n: int, equalities: int, inequalities: int) -> None:
        self._n, self._m = n, equalities
        #: The active set, and the next one proposed by `solve_condensed`.
        self._sides = np.zeros((2, n + inequalities), dtype=np.int8)
        self.side = self._sides[0]  # of [x; C x]: 1 at an active upper bound, -1 at a lower one, else 0
        self._count = 0  # of active bounds

    def adopt_multipliers(self, multipliers: Array) -> None:
        """Adopt the active set of multipliers, (n + m_in,)."""
        self.adopt((multipliers > 0.0).astype(np.int8) - (multipliers < 0.0))

    def adopt(self, side: np.ndarray | int) -> None:
        """Adopt an active set, or 0 for no active bounds."""
        self.side[:] = side
        self._count = int(np.count_nonzero(self.side))

    def memory(self) -> dict[str, Any]:
        """Return the active set, for `recall`."""
        return {"side": self.side.copy()}

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Restore the result of `memory`, if of the same size."""
        side = np.array(memory["side"], dtype=np.int8)
        if side.shape == self.side.shape:
            self.adopt(side)

    def solve(self, problem: QuadraticProgram) -> Answer | None:
        """Solve with the stored active set or the next sets; None if all are wrong."""
        if self._m + self._count > self._n:
            return None
        squares = problem.cost.squares
        if squares is None or len(squares.weights) > _MOST_ROWS * self._n:
            return self._full(problem)
        memory = LevelWorkspace(problem, squares.base)
        outcome, number, cost = self.solve_level(problem, squares, memory, tries=_TRIES)
        if outcome != kernel.SOLVED:
            return None
        residuals = memory.residuals
        cost += problem.cost.squares_constant
        return Answer(residuals.value[: self._n], "optimal", number, memory.multipliers, residuals, cost)

    def solve_level(
        self, problem: QuadraticProgram, squares: LeastSquares, memory: LevelWorkspace, kept: int = 0, tries: int = 1
    ) -> tuple[int, int, float]:
        """Solve the condensed system with the cost of a level.

        A wrong active set is replaced by the violated constraints and the multipliers of right sign (primal-dual active
        set strategy: Hintermüller, Ito, Kunisch, SIAM J. Optim. 13, 2002). A failure restores the first set.

        `memory` has the kept rows of the levels above, and receives the solution. Lower levels must keep `kept` cost
        rows; `tries` is the largest number of active sets. Returns outcome and number of the last try, and the sum of
        squares.
        """
        found, number, side = memory.residuals, 0, None
        while True:
            number += 1
            outcome, cost, found.least_room, found.largest_equality = kernel.solve_condensed(
                squares, self._sides, memory.rows, memory.above, kept, memory.multipliers, found.memory
            )
            if outcome != kernel.WRONG_SET or number == tries:
                break
            side = self.side.copy() if side is None else side
            self.adopt(self._sides[1])
        if outcome == kernel.SOLVED:
            memory.above = (memory.above or len(problem.b) - squares.base) + kept
        elif side is not None:
            self.adopt(side)
        return outcome, number, cost

    def _full(self, problem: QuadraticProgram) -> Answer | None:
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
        _, _, answer, info = dgesv(K.T, right, overwrite_a=True)  # the transpose of the symmetric K saves a copy
        if info != 0 or not answer.dot(answer) <= kernel.LARGEST**2:
            return None
        residuals = problem.residuals(answer[:n])
        if not residuals.violation <= kernel.FEASIBLE or (self.side[active] * answer[m:] < 0.0).any():
            return None
        multipliers = np.zeros(len(self.side))
        multipliers[active] = answer[m:]
        # xᵀHx = -gᵀx - bᵀy - wᵀλ by stationarity; right is [-g; b; w].
        cost = problem.cost.constant - 0.5 * float(right @ answer)
        return Answer(answer[:n], "optimal", 1, multipliers, residuals, cost)
