"""What every solver back end does."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np

from wbc_controller.core.problem import QuadraticProgram
from wbc_controller.records import Array


@dataclass(frozen=True, slots=True)
class Answer:
    """What a solver says.

    Attributes:
        x: the minimizer, (n,); None where there is none.
        status: the solver's own word for the outcome.
        iterations: the solver's own count.
        multipliers: of the bounds of x, then of the rows of C, (n + m_in,): positive at an upper bound, negative at a
            lower one, 0 away from both; with those of the equalities, Hx + g + Aᵀy + [I; C]ᵀ multipliers = 0.
    """

    x: Array | None
    status: str
    iterations: int
    multipliers: Array = field(default_factory=lambda: np.zeros(0))


class Solver(ABC):
    """A solver bound to problems of one size; it may keep what helps the next solve.

    Attributes:
        tolerance: largest constraint violation that its answers may have, in the problem's units.
        for_levels: whether it solves the problems of levels below the first, where feasible sets are thin.
    """

    tolerance: float
    for_levels = True

    @abstractmethod
    def solve(self, problem: QuadraticProgram) -> Answer:
        """Solve a problem, warm-started from the last answer. Never raises for a problem without solution."""
