"""What every task is: a Jacobian, a drift, an error, and the rate of change asked for."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from wbc_controller.core.dynamics import Dynamics
from wbc_controller.errors import ConfigurationError
from wbc_controller.records import Array, Reference

#: A gain: one number, or one for each axis.
Gains = float | Sequence[float]


def gains(values: Gains, size: int, key: str) -> Array:
    """Read a gain that is one number, or one for each axis.

    Args:
        values: the number or numbers.
        size: number of axes, masked or not.
        key: the configuration key that holds it, for the error.

    Returns:
        An array of the shape () or (size,).

    Raises:
        ConfigurationError: where the length is another one.
    """
    array = np.asarray(values, dtype=np.float64)
    if array.shape not in ((), (size,)):
        raise ConfigurationError(
            f"{key} has {array.size} values; it takes one number, or a list with one for each of the task's {size} axes"
        )
    return array


class Task(ABC):
    """A quantity x that should follow a reference by the choice of v̇.

    With x⁽ⁿ⁾ = J v̇ + δ, where the derivative x⁽ⁿ⁾ is the first in which v̇ appears and the drift δ is what it is at
    v̇ = 0, the task asks for

        J v̇ = x⁽ⁿ⁾* - δ

    in the least-squares sense. What x⁽ⁿ⁾* is, the two kinds of task say: `MotionTask` for quantities x(q), and
    `RateTask` for quantities x(q, v).

    Attributes:
        name: the task's name.
        rows: the components that the mask leaves, (k,).
    """

    #: Number of components before the mask.
    size: int

    def __init__(self, name: str, mask: Sequence[bool]) -> None:
        self.name = name
        self.rows = np.flatnonzero(np.asarray(mask))

    @property
    def dimension(self) -> int:
        """Number of rows that the task adds to the cost."""
        return len(self.rows)

    @abstractmethod
    def position(self, dynamics: Dynamics) -> Array:
        """Present value x, in the form of a reference's position."""

    @abstractmethod
    def error(self, dynamics: Dynamics, position: Array) -> Array:
        """Displacement from x to a reference position, (size,)."""

    @abstractmethod
    def jacobian(self, dynamics: Dynamics) -> Array:
        """J, (size, nv)."""

    @abstractmethod
    def drift(self, dynamics: Dynamics) -> Array:
        """δ, (size,)."""

    @abstractmethod
    def wanted(self, dynamics: Dynamics, reference: Reference, error: Array) -> Array:
        """x⁽ⁿ⁾*, (size,)."""

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
        right = self.wanted(dynamics, reference, error) - self.drift(dynamics)
        return self.jacobian(dynamics)[rows], right[rows], float(np.linalg.norm(error[rows]))


class MotionTask(Task):
    """A task on a quantity x(q): a spring and a damper on its error.

    With ẋ = J v and ẍ = J v̇ + J̇v, it asks for

        ẍ* = ẍ_ref + D (ẋ_ref - ẋ) + K e

    where e is the error from x to x_ref, K the stiffness and D the damping, each one number or one for each axis.

    Attributes:
        stiffness: K, 1/s², () or (size,).
        damping: D, 1/s, () or (size,).
    """

    def __init__(
        self, name: str, mask: Sequence[bool], *, stiffness: Gains = 100.0, damping: Gains | None = None
    ) -> None:
        """Make a task.

        Args:
            name: the task's name.
            mask: axes concerned, (size,).
            stiffness: K, 1/s².
            damping: D, 1/s; critical, 2√K on each axis, where it is not given.

        Raises:
            ConfigurationError: where a list of gains has another length than the mask.
        """
        super().__init__(name, mask)
        self.stiffness = gains(stiffness, len(mask), f"tasks.{name}.stiffness")
        self.damping = (
            2.0 * np.sqrt(self.stiffness) if damping is None else gains(damping, len(mask), f"tasks.{name}.damping")
        )

    @abstractmethod
    def velocity(self, dynamics: Dynamics) -> Array:
        """Present velocity ẋ, (size,)."""

    def wanted(self, dynamics: Dynamics, reference: Reference, error: Array) -> Array:
        """ẍ*, (size,)."""
        return np.asarray(
            reference.acceleration
            + self.damping * (reference.velocity - self.velocity(dynamics))
            + self.stiffness * error
        )


class RateTask(Task):
    """A task on a quantity x(q, v), with ẋ = J v̇ + δ: its error decays by itself, and has no spring.

    It asks for

        ẋ* = ẋ_ref + k e

    where e = x_ref - x is the error and k the gain, one number or one for each axis: left alone, e decays as exp(-k t).
    Of a reference's three parts the position is x_ref, the velocity is ẋ_ref, and the acceleration has no use.

    Attributes:
        gain: k, 1/s, () or (size,).
    """

    def __init__(self, name: str, mask: Sequence[bool], *, gain: Gains, key: str) -> None:
        """Make a task.

        Args:
            name: the task's name.
            mask: axes concerned, (size,).
            gain: k, 1/s.
            key: the configuration key that holds the gain, for the error.

        Raises:
            ConfigurationError: where a list of gains has another length than the mask.
        """
        super().__init__(name, mask)
        self.gain = gains(gain, len(mask), f"tasks.{name}.{key}")

    def error(self, dynamics: Dynamics, position: Array) -> Array:
        """x_ref - x, (size,)."""
        return np.asarray(position - self.position(dynamics))

    def wanted(self, dynamics: Dynamics, reference: Reference, error: Array) -> Array:
        """ẋ*, (size,)."""
        return np.asarray(reference.velocity + self.gain * error)
