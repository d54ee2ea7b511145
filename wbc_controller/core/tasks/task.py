"""What every task is: a Jacobian, a drift, an error, and the acceleration asked for."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from wbc_controller.core.dynamics import Dynamics
from wbc_controller.records import Array, Reference


class Task(ABC):
    """A quantity x(q) that should follow a reference.

    With ẋ = J v and ẍ = J v̇ + J̇v, the task asks for

        J v̇ = ẍ_ref + D (ẋ_ref - ẋ) + K e - J̇v

    in the least-squares sense, where e is the error from x to x_ref, K the stiffness and D the damping.

    Attributes:
        name: the task's name.
        rows: the components that the mask leaves, (k,).
        stiffness: K, 1/s².
        damping: D, 1/s.
    """

    #: Number of components before the mask.
    size: int

    def __init__(
        self, name: str, mask: Sequence[bool], *, stiffness: float = 100.0, damping: float | None = None
    ) -> None:
        self.name = name
        self.rows = np.flatnonzero(np.asarray(mask))
        self.stiffness = stiffness
        self.damping = 2.0 * math.sqrt(stiffness) if damping is None else damping

    @property
    def dimension(self) -> int:
        """Number of rows that the task adds to the cost."""
        return len(self.rows)

    @abstractmethod
    def position(self, dynamics: Dynamics) -> Array:
        """Present value x(q), in the form of a reference's position."""

    @abstractmethod
    def velocity(self, dynamics: Dynamics) -> Array:
        """Present velocity ẋ, (size,)."""

    @abstractmethod
    def error(self, dynamics: Dynamics, position: Array) -> Array:
        """Displacement from x(q) to a reference position, (size,)."""

    @abstractmethod
    def jacobian(self, dynamics: Dynamics) -> Array:
        """J, (size, nv)."""

    @abstractmethod
    def drift(self, dynamics: Dynamics) -> Array:
        """J̇v, (size,)."""

    def rest(self, dynamics: Dynamics) -> Reference:
        """Reference that keeps the present value."""
        still = np.zeros(self.size)
        return Reference(self.position(dynamics), still, still)

    def equation(self, dynamics: Dynamics, reference: Reference) -> tuple[Array, Array, float]:
        """Rows of the least-squares problem J v̇ = b.

        Args:
            dynamics: the snapshot.
            reference: what to follow.

        Returns:
            J (k, nv), b (k,), and the Euclidean norm of the masked error.
        """
        rows = self.rows
        error = self.error(dynamics, reference.position)
        right = (
            reference.acceleration
            + self.damping * (reference.velocity - self.velocity(dynamics))
            + self.stiffness * error
            - self.drift(dynamics)
        )
        return self.jacobian(dynamics)[rows], right[rows], float(np.linalg.norm(error[rows]))
