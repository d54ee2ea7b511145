"""What a solver answers."""

from __future__ import annotations

import numpy as np

from wbc_controller.inverse_dynamics.formulation.problem import Residuals
from wbc_controller.records import Array, LevelReport

#: Status of a problem with an entry that is not finite, or a bound that is NaN.
NOT_FINITE = "not finite"


class Answer:
    """The result of a solver.

    Attributes:
        x: the minimizer, (n,); None if none was found.
        status: the solver's own status.
        iterations: the solver's own count.
        residuals: residuals of the problem's constraints at x, if they have been computed.
        cost: cost at x, if it has been computed.
        levels: the quadratic programs that were solved, where these are several.
        relaxed: groups in which a bound is missed, and lower levels that failed.
    """

    __slots__ = ("_multipliers", "cost", "iterations", "levels", "relaxed", "residuals", "status", "x")

    def __init__(
        self,
        x: Array | None,
        status: str,
        iterations: int,
        multipliers: Array | None = None,
        residuals: Residuals | None = None,
        cost: float | None = None,
    ) -> None:
        """Store what was found; `multipliers` where they are not those of the residuals."""
        self.x = x
        self.status = status
        self.iterations = iterations
        self._multipliers = multipliers
        self.residuals = residuals
        self.cost = cost
        self.levels: tuple[LevelReport, ...] = ()
        self.relaxed: tuple[str, ...] = ()

    @property
    def multipliers(self) -> Array:
        """Of the bounds of x, then of the rows of C, (n + m_in,).

        Positive at an upper bound, negative at a lower one, 0 for inactive constraints. With the multipliers y of the
        equality constraints, Hx + g + Aᵀy + [I; C]ᵀ multipliers = 0.
        """
        if self._multipliers is not None:
            return self._multipliers
        return np.zeros(0) if self.residuals is None else self.residuals.multipliers

    @multipliers.setter
    def multipliers(self, multipliers: Array) -> None:
        self._multipliers = multipliers
