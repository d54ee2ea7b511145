"""What every solver back end does."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np

from wbc_controller.core.program.problem import QuadraticProgram, Residuals
from wbc_controller.records import Array

#: Status of a problem with an entry that is not finite, or a bound that is NaN.
NOT_FINITE = "not finite"


@dataclass(slots=True)
class Answer:
    """What a solver says.

    Attributes:
        x: the minimizer, (n,); None where there is none.
        status: the solver's own word for the outcome.
        iterations: the solver's own count.
        multipliers: of the bounds of x, then of the rows of C, (n + m_in,): positive at an upper bound, negative at a
            lower one, 0 away from both; with those of the equalities, Hx + g + Aᵀy + [I; C]ᵀ multipliers = 0.
        residuals: of the problem's constraints at x, where the solver has computed them.
        cost: of x, likewise.
    """

    x: Array | None
    status: str
    iterations: int
    multipliers: Array = field(default_factory=lambda: np.zeros(0))
    residuals: Residuals | None = None
    cost: float | None = None


class Solver(ABC):
    """A solver bound to problems of one size; it may keep what helps the next solve.

    Attributes:
        tolerance: largest constraint violation that its answers may have, in the problem's units.
        for_levels: whether it solves the problems of levels below the first, where feasible sets are thin.
    """

    tolerance: float
    for_levels = True

    def solve(self, problem: QuadraticProgram) -> Answer:
        """Solve a problem, warm-started from the last answer. Never raises for a problem without solution."""
        answer = self._guess(problem)
        if answer is not None:
            return answer
        if not problem.is_finite:  # back ends may spin for seconds on it, or raise
            return Answer(None, NOT_FINITE, 0)
        return self._search(problem)

    def _guess(self, problem: QuadraticProgram) -> Answer | None:
        """An answer without a search, if there is one; it is checked, so that it is finite in all its parts."""
        return None

    @abstractmethod
    def _search(self, problem: QuadraticProgram) -> Answer:
        """Solve a problem that is finite."""
