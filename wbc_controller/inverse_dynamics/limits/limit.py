"""Base class of limits on linear combinations of accelerations."""

from __future__ import annotations

from abc import ABC, abstractmethod

from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.records import Array


class RowLimit(ABC):
    """Inequality constraints lower ≤ G v̇ ≤ upper with a constant number of rows.

    Attributes:
        names: name of each row, ``<kind>:<owner>``, as in `Solution.binding`; `fill` may change them.
        kind: name of the group of rows for relaxation.
        unit: unit of G v̇.
        summary: description in one line.
    """

    names: tuple[str, ...]
    kind: str
    unit: str
    summary: str = ""

    @property
    def full_name(self) -> str:
        """Kind for error messages."""
        return f"limit {self.kind!r}"

    @abstractmethod
    def fill(self, dynamics: Dynamics, period: float, rows: Array, lower: Array, upper: Array) -> None:
        """Write the rows G, (k, nv), and the bounds, (k,), infinite for none, at one state.

        The acceleration is constant for the period, s.
        """
