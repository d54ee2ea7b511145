"""The base class of solver back ends, and the answer that they give."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from wbc_controller.core.program.problem import QuadraticProgram, Residuals
from wbc_controller.records import Array

#: Status of a problem with an entry that is not finite, or a bound that is NaN.
NOT_FINITE = "not finite"


@dataclass(slots=True)
class Answer:
    """The result of a solver.

    Attributes:
        x: the minimizer, (n,); None if none was found.
        status: the solver's own status.
        iterations: the solver's own count.
        multipliers: of the bounds of x, then of the rows of C, (n + m_in,): positive at an upper bound, negative at a
            lower one, 0 for inactive constraints. With the multipliers y of the equality constraints,
            Hx + g + Aᵀy + [I; C]ᵀ multipliers = 0.
        residuals: residuals of the problem's constraints at x, if the solver has computed them.
        cost: cost at x, if the solver has computed it.
    """

    x: Array | None
    status: str
    iterations: int
    multipliers: Array = field(default_factory=lambda: np.zeros(0))
    residuals: Residuals | None = None
    cost: float | None = None


class Solver(ABC):
    """A solver for problems of one size; it may keep a warm start for the next solve.

    Attributes:
        tolerance: largest constraint violation that its solutions may have, in the problem's units.
        for_levels: whether it is accurate enough for the problems of lower levels, whose feasible sets are thin.
    """

    tolerance: float
    for_levels = True

    def solve(self, problem: QuadraticProgram) -> Answer:
        """Solve a problem, warm-started from the last solution; never raises for an infeasible problem."""
        answer = self._guess(problem)
        if answer is not None:
            return answer
        if not problem.is_finite:  # back ends may iterate for seconds on such a problem, or raise
            return Answer(None, NOT_FINITE, 0)
        return self._search(problem)

    def memory(self) -> dict[str, Any] | None:
        """What the solver remembers for its next solve; None where that is in a back end, and cannot be known."""
        return None

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Go on from what `memory` gave.

        Raises:
            NotImplementedError: where the solver gives none.
        """
        raise NotImplementedError(f"{type(self).__name__} has no memory that can be read")

    def _guess(self, problem: QuadraticProgram) -> Answer | None:
        """A solution from the warm start alone, checked and finite; None if the warm start does not give one."""
        return None

    @abstractmethod
    def _search(self, problem: QuadraticProgram) -> Answer:
        """Solve a problem whose entries are all finite."""
