"""Base class of limits."""

from abc import ABC, abstractmethod

from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.records import Array


class RowLimit(ABC):
    """Inequality constraints lower ≤ G v̇ ≤ upper with a constant number of rows."""

    names: tuple[str, ...]  # of the rows, ``<kind>:<owner>``, as in `Solution.binding`; `fill` may change them
    kind: str  # group of rows for relaxation
    unit: str  # of G v̇
    summary: str = ""  # one line

    @property
    def full_name(self) -> str:
        """Kind, for errors."""
        return f"limit {self.kind!r}"

    @abstractmethod
    def fill(self, dynamics: Dynamics, period: float, rows: Array, lower: Array, upper: Array) -> None:
        """Write G, (k, nv), and bounds, (k,), possibly infinite, for a period in s."""
