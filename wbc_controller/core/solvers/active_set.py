"""A guess at which inequalities hold with equality, and the answer that it leads to: one linear solve."""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dgesv

from wbc_controller.core.problem import QuadraticProgram
from wbc_controller.core.solvers.solver import Answer
from wbc_controller.records import Array

#: How many guesses are tried.
_GUESSES = 3
#: Largest violation of a constraint, as DAQP has it, in the problem's units.
_FEASIBLE = 1.0e-8
#: Largest norm of the solution of a linear system that is not next to singular: of usual ones it is 1e3.
_LARGEST = 1.0e8


class ActiveSet:
    """Solves a quadratic program from the active set of the one before.

    From one cycle to the next the inequalities that hold with equality hardly change, and often there are none. Where
    they are known, the answer is that of a linear system, with W the active ones among the rows [I; C] and w their
    bounds,

        | H  Aᵀ  Wᵀ | | x |   | -g |
        | A  0   0  | | y | = |  b |
        | W  0   0  | | λ |   |  w |

    which takes a fraction of the time of a solver that has to look for them. x is the minimizer exactly if it meets all
    inequalities and no multiplier λ has the wrong sign, and that is checked. A wrong guess is mended: what is violated
    joins, and what would rather leave its bound leaves (the primal-dual active set method of Hintermüller, Ito and
    Kunisch, SIAM J. Optim. 13, 2002). After some guesses the search is left to a solver.
    """

    def __init__(self, n: int, equalities: int, inequalities: int) -> None:
        """Start with no inequality active."""
        self._n, self._m = n, equalities
        self._side = np.zeros(n + inequalities, dtype=np.int8)  # 1 at the upper bound, -1 at the lower one
        self._memory = np.zeros((2 * n + equalities) ** 2)

    def learn(self, multipliers: Array) -> None:
        """Take the active set of an answer, (n + m_in,) as in `Answer`."""
        self._side = (multipliers > 0.0).astype(np.int8) - (multipliers < 0.0)

    def solve(self, problem: QuadraticProgram) -> Answer | None:
        """Try it; None where no guess was right."""
        for guess in range(1, _GUESSES + 1):
            active = self._side.nonzero()[0]
            if self._m + len(active) > self._n:
                return None
            found = self._on(problem, active)
            if found is None:
                return None
            answer, objective = found
            x, costs = answer[: self._n], answer[self._n + self._m :]
            residuals = problem.residuals(x)
            wrong = active[self._side[active] * costs < 0.0] if len(active) else active
            if not len(wrong) and residuals.violation <= _FEASIBLE:
                multipliers = np.zeros(len(self._side))
                if len(active):
                    multipliers[active] = costs
                return Answer(x, "optimal", guess, multipliers, residuals, objective)
            beyond = (residuals.room < -_FEASIBLE) & (self._side == 0)
            if not (len(wrong) or beyond.any()):
                return None  # an equality is violated, or a value is not finite
            self._side = self._side + beyond[1] - beyond[0]
            self._side[wrong] = 0
        return None

    def _on(self, problem: QuadraticProgram, active: np.ndarray) -> tuple[Array, float] | None:
        """[x, y, λ] with these inequalities at their bounds, and the objective; None where they are not determined."""
        n, m = self._n, self._n + self._m
        size = m + len(active)
        K = self._memory[: size * size].reshape(size, size)
        right = np.empty(size)
        K[:n, :n] = problem.H
        K[n:m, :n] = problem.A
        np.negative(problem.g, out=right[:n])
        right[n:m] = problem.b
        if len(active):
            bounds = active[active < n]
            K[m:, :n] = 0.0
            K[m + np.arange(len(bounds)), bounds] = 1.0
            K[m + len(bounds) :, :n] = problem.C[active[len(bounds) :] - n]
            right[m:] = problem.bounds[(self._side[active] > 0).astype(np.intp), active]
        K[:n, n:] = K[n:, :n].T
        K[n:, n:] = 0.0
        _, _, answer, info = dgesv(K.T, right, overwrite_a=True)  # K is symmetric: its transpose saves a copy
        usable = info == 0 and answer @ answer <= _LARGEST**2  # False for NaN
        # xᵀHx is -gᵀx - bᵀy - wᵀλ by the first rows, so that this is ½ xᵀHx + gᵀx.
        return (answer, -0.5 * float(right @ answer)) if usable else None
