"""Answer of a solver: minimizer, status, multipliers and residuals."""

from dataclasses import dataclass, field

import numpy as np

from wbc_controller.inverse_dynamics.formulation.problem import Residuals
from wbc_controller.records import Array, LevelReport

#: Status of a problem with NaN, or with an entry that is not finite.
NOT_FINITE = "not finite"


@dataclass(slots=True)
class Answer:
    """Result of a solver."""

    x: Array | None  # minimizer, (n,); None if not found
    status: str  # status of the solver
    iterations: int  # as counted by the solver
    # of the bounds of x, then of the rows of C, (n + m_in,): positive at an upper bound, negative at a lower one. With
    # the multipliers y of the equality constraints, Hx + g + Aᵀy + [I; C]ᵀ multipliers = 0
    multipliers: Array = field(default_factory=lambda: np.zeros(0))
    residuals: Residuals | None = None  # at x, if computed
    cost: float | None = None  # at x, if computed
    levels: tuple[LevelReport, ...] = ()  # one per priority level
    relaxed: tuple[str, ...] = ()  # groups with violated bounds, and failed lower levels
