"""Answer of a solver."""

from dataclasses import dataclass, field

import numpy as np

from wbc_controller.inverse_dynamics.formulation.problem import Residuals
from wbc_controller.records import Array, LevelReport

NOT_FINITE = "not finite"  # also for NaN


@dataclass(slots=True)
class Answer:
    """Result of a solver."""

    x: Array | None  # (n,)
    status: str  # by the solver
    iterations: int  # by the solver
    # of [x; C x], (n + m_in,), positive at an upper bound; Hx + g + Aᵀy + [I; C]ᵀ multipliers = 0
    multipliers: Array = field(default_factory=lambda: np.zeros(0))
    residuals: Residuals | None = None  # at x
    cost: float | None = None  # at x
    levels: tuple[LevelReport, ...] = ()  # one per priority level
    relaxed: tuple[str, ...] = ()  # groups with violated bounds, and failed lower levels
