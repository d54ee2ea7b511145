"""The answer of a solver: minimizer, status, multipliers and residuals."""

from dataclasses import dataclass, field

import numpy as np

from wbc_controller.inverse_dynamics.formulation.problem import Residuals
from wbc_controller.records import Array, LevelReport

#: Status of a problem with an entry that is not finite, or a bound that is NaN.
NOT_FINITE = "not finite"


@dataclass(slots=True)
class Answer:
    """The result of a solver."""

    x: Array | None  # the minimizer, (n,); None if none was found
    status: str  # the solver's own status
    iterations: int  # the solver's own count
    # of the bounds of x, then of the rows of C, (n + m_in,): positive at an upper bound, negative at a lower one, 0 for
    # inactive constraints. With the multipliers y of the equality constraints, Hx + g + Aᵀy + [I; C]ᵀ multipliers = 0
    multipliers: Array = field(default_factory=lambda: np.zeros(0))
    residuals: Residuals | None = None  # residuals of the problem's constraints at x, if they have been computed
    cost: float | None = None  # cost at x, if it has been computed
    levels: tuple[LevelReport, ...] = ()  # the quadratic programs that were solved, if there are several
    relaxed: tuple[str, ...] = ()  # groups in which a bound is missed, and lower levels that failed
