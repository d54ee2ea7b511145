"""The base class of solver back ends."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from wbc_controller.inverse_dynamics.formulation.answer import NOT_FINITE, Answer
from wbc_controller.inverse_dynamics.formulation.problem import QuadraticProgram
from wbc_controller.inverse_dynamics.solvers.active_set import ActiveSet


class Solver(ABC):
    """A solver for problems of one size; it may keep a warm start for the next solve.

    Attributes:
        tolerance: largest constraint violation that its solutions may have, in the problem's units.
        for_levels: whether it is accurate enough for the problems of lower levels, whose feasible sets are thin.
        active_set: that of the last problem, which is tried first; None where the solver has a warm start of its own.
    """

    tolerance: float
    for_levels = True
    active_set: ActiveSet | None = None

    def solve(self, problem: QuadraticProgram) -> Answer:
        """Solve a problem, warm-started from the last solution; never raises for an infeasible problem."""
        if self.active_set is not None:
            answer = self.active_set.solve(problem)
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

    @abstractmethod
    def _search(self, problem: QuadraticProgram) -> Answer:
        """Solve a problem whose entries are all finite."""
