"""What every task is: rows of a least-squares problem, from an error and the rate of change asked for."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from wbc_controller.core.robot.dynamics import Dynamics
from wbc_controller.core.tasks.form import ReferenceForm
from wbc_controller.errors import ConfigurationError
from wbc_controller.records import Array, Reference, frozen

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
    """Something that is wanted: rows of a least-squares problem in the unknowns, with a weight and a level.

    Two kinds: an `AccelerationTask` is about v̇, an `EffortTask` about contact forces or torques.

    Attributes:
        name: the task's name.
        rows: the components that the mask leaves, (k,).
        level: priority; 0 is the highest, and no task worsens one of a smaller level. Set before the controller is
            made.
        tolerance: how far from the reference the quantity may be at no cost, in the unit of the error, () or (size,);
            None where the task asks for the reference itself. Set before the controller is made.
        weight: of a user's own task its weight; of a configured one its settings say so.
        enabled: whether a user's own task is on at activation; likewise.
        setpoint_duration: time in which a user's own task reaches a new setpoint, s; likewise.
    """

    #: Number of components before the mask.
    size: int
    level: int = 0
    tolerance: Array | None = None
    weight: float = 1.0
    enabled: bool = True
    setpoint_duration: float = 1.0
    #: The attributes that are gains, each () or (size,).
    gain_names: tuple[str, ...] = ()

    def __init__(self, name: str, mask: Sequence[bool]) -> None:
        self.name = name
        self.rows = np.flatnonzero(np.asarray(mask))
        self._whole = len(self.rows) == len(mask)

    @property
    def gains(self) -> Mapping[str, Array]:
        """The gains by name."""
        return {name: getattr(self, name) for name in self.gain_names}

    @property
    def form(self) -> ReferenceForm:
        """How the position of its reference is written."""
        return ReferenceForm(vector=self.size)

    @property
    def dimension(self) -> int:
        """Number of rows that the task adds to the cost."""
        return len(self.rows)

    @abstractmethod
    def rest(self, dynamics: Dynamics) -> Reference:
        """Reference that the task has before it is given one."""

    def band(self) -> Array:
        """What the tolerance is in the rows of the least-squares problem, (k,): their half-width."""
        if self.tolerance is None:
            return np.zeros(self.dimension)
        return np.broadcast_to(self.tolerance * self._stiffness_of_rows(), (self.size,))[self.rows]

    @abstractmethod
    def _stiffness_of_rows(self) -> Array:
        """By what the rows move per unit of the error, () or (size,)."""


class AccelerationTask(Task):
    """A quantity x that should follow a reference by the choice of v̇.

    With x⁽ⁿ⁾ = J v̇ + δ, where the derivative x⁽ⁿ⁾ is the first in which v̇ appears and the drift δ is what it is at
    v̇ = 0, the task asks for

        J v̇ = x⁽ⁿ⁾* - δ

    in the least-squares sense. What x⁽ⁿ⁾* is, the two kinds of task say: `MotionTask` for quantities x(q), and
    `RateTask` for quantities x(q, v).

    Attributes:
        columns: for a task whose rows are single accelerations, J = I[columns], which they are; None for others.
        has_drift: whether δ can be other than 0.
    """

    columns: np.ndarray | slice | None = None
    has_drift = True

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
    def right(self, dynamics: Dynamics, reference: Reference) -> tuple[Array, Array]:
        """x⁽ⁿ⁾* - δ and the error, both (size,): all axes, whatever the mask."""

    def rest(self, dynamics: Dynamics) -> Reference:
        """Reference that keeps the present value."""
        still = frozen(np.zeros(self.size))
        return Reference(frozen(self.position(dynamics)), still, still)

    def equation(self, dynamics: Dynamics, reference: Reference) -> tuple[Array, Array, Array]:
        """Rows of the least-squares problem J v̇ = b.

        Args:
            dynamics: the snapshot.
            reference: what to follow.

        Returns:
            J (k, nv), b (k,), and the masked error (k,).
        """
        right, error = self.right(dynamics, reference)
        J, rows = self.jacobian(dynamics), self.rows
        return (J, right, error) if self._whole else (J[rows], right[rows], error[rows])


class Efforts(Protocol):
    """The torques and contact forces of a cycle as affine functions of the problem's unknowns x, (n,)."""

    @property
    def torque_map(self) -> tuple[Array, Array]:
        """R (na, n) and r (na,), so that τ = R x + r in N·m."""

    def force_map(self, contact: str) -> Array | None:
        """R (k, n), so that the contact's force in its own coordinates is R x; None while it is not active."""


class EffortTask(Task):
    """Contact forces or torques that should be what a reference says; they have no dynamics, so there are no gains.

    Of a reference's three parts only the position counts.

    Attributes:
        target: the reference before another one is given, (size,).
    """

    def __init__(self, name: str, mask: Sequence[bool], target: Array) -> None:
        super().__init__(name, mask)
        self.target = target

    def rest(self, dynamics: Dynamics) -> Reference:
        """The target."""
        still = np.zeros(self.size)
        return Reference(self.target, still, still)

    def _stiffness_of_rows(self) -> Array:
        return np.ones(())

    @abstractmethod
    def equation(self, efforts: Efforts, reference: Reference) -> tuple[Array, Array] | None:
        """Rows of the least-squares problem R x = r in the problem's unknowns.

        Args:
            efforts: torques and contact forces as functions of the unknowns.
            reference: what is wanted.

        Returns:
            R (k, n), r (k,); None where the quantity does not exist, such as the force of a contact that is not active.
        """


class MotionTask(AccelerationTask):
    """A task on a quantity x(q): a spring and a damper on its error.

    With ẋ = J v and ẍ = J v̇ + J̇v, it asks for

        ẍ* = ẍ_ref + D (ẋ_ref - ẋ) + K e

    where e is the error from x to x_ref, K the stiffness and D the damping, each one number or one for each axis.

    Attributes:
        stiffness: K, 1/s², () or (size,).
        damping: D, 1/s, () or (size,).
    """

    gain_names = ("stiffness", "damping")

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
        self._followed: Reference | None = None
        self._damping = self.damping
        self._feed_forward: Array | None = None

    def _stiffness_of_rows(self) -> Array:
        return self.stiffness

    @abstractmethod
    def velocity(self, dynamics: Dynamics) -> Array:
        """Present velocity ẋ, (size,)."""

    def right(self, dynamics: Dynamics, reference: Reference) -> tuple[Array, Array]:
        """ẍ* - J̇v and the error, both (size,)."""
        error = self.error(dynamics, reference.position)
        if reference is not self._followed or self.damping is not self._damping:
            self._follow(reference)
        right = self.stiffness * error
        right -= self.damping * self.velocity(dynamics)
        if self._feed_forward is not None:
            right += self._feed_forward
        if self.has_drift:
            right -= self.drift(dynamics)
        return right, error

    def _follow(self, reference: Reference) -> None:
        """Compute ẍ_ref + D ẋ_ref once, for a reference that is known again and cannot change."""
        changes = reference.velocity.flags.writeable or reference.acceleration.flags.writeable
        self._followed, self._damping = None if changes else reference, self.damping
        feed_forward = reference.acceleration + self.damping * reference.velocity
        self._feed_forward = None if feed_forward.dot(feed_forward) == 0.0 else feed_forward


class RateTask(AccelerationTask):
    """A task on a quantity x(q, v), with ẋ = J v̇ + δ: its error decays by itself, and has no spring.

    It asks for

        ẋ* = ẋ_ref + k e

    where e = x_ref - x is the error and k the gain, one number or one for each axis: left alone, e decays as exp(-k t).
    Of a reference's three parts the position is x_ref, the velocity is ẋ_ref, and the acceleration has no use.

    Attributes:
        gain: k, 1/s, () or (size,).
    """

    gain_names = ("gain",)

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

    def _stiffness_of_rows(self) -> Array:
        return self.gain

    def error(self, dynamics: Dynamics, position: Array) -> Array:
        """x_ref - x, (size,)."""
        return np.asarray(position - self.position(dynamics))

    def right(self, dynamics: Dynamics, reference: Reference) -> tuple[Array, Array]:
        """ẋ* - δ and the error, both (size,)."""
        error = self.error(dynamics, reference.position)
        return reference.velocity + self.gain * error - self.drift(dynamics), error
