"""Base class of solver back ends."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from wbc_controller.inverse_dynamics.formulation.problem import NOT_FINITE, Answer, QuadraticProgram
from wbc_controller.inverse_dynamics.solvers.active_set import ActiveSet


class Solver(ABC):
    """Solver for problems of one size, with an optional warm start."""

    tolerance: float  # of constraint violations, in the problem's units
    for_levels = True  # accurate enough for lower levels with thin feasible sets
    active_set: ActiveSet | None = None  # of the last problem; None for solvers with their own warm start

    def solve(self, problem: QuadraticProgram) -> Answer:
        """Solve a problem, warm-started; never raises for infeasibility."""
        if self.active_set is not None:
            answer = self.active_set.solve(problem)
            if answer is not None:
                return answer
        if not problem.is_finite:  # back ends may iterate for seconds, or raise
            return Answer(None, NOT_FINITE, 0)
        return self._search(problem)

    def memory(self) -> dict[str, Any] | None:
        """Return the state for the next solve; None if a back end hides it."""
        return None if self.active_set is None else self.active_set.memory()

    def recall(self, memory: Mapping[str, Any]) -> None:
        """Restore the result of `memory`; `NotImplementedError` if the state is hidden."""
        if self.active_set is None:
            raise NotImplementedError(f"{type(self).__name__} cannot restore its state")
        self.active_set.recall(memory)

    @abstractmethod
    def _search(self, problem: QuadraticProgram) -> Answer:
        """Solve a problem with finite entries."""
