"""The base class of limits on linear combinations of accelerations."""

from __future__ import annotations

from abc import ABC, abstractmethod

from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.records import Array


class RowLimit(ABC):
    """Inequality constraints lower ≤ G v̇ ≤ upper of the quadratic program; the number of rows never changes.

    Attributes:
        names: a name for each row, ``<kind>:<owner>``, as in `Solution.binding`. `fill` may change them.
        kind: name of the group in which the rows are relaxed if there is no solution.
        unit: unit of G v̇.
        summary: one line of description.
    """

    names: tuple[str, ...]
    kind: str
    unit: str
    summary: str = ""

    @property
    def full_name(self) -> str:
        """Kind, for error messages."""
        return f"limit {self.kind!r}"

    @abstractmethod
    def fill(self, dynamics: Dynamics, period: float, rows: Array, lower: Array, upper: Array) -> None:
        """Write the rows G, (k, nv), and the bounds, (k,), infinite if there is none, for one state.

        The acceleration is held for the period, s.
        """
