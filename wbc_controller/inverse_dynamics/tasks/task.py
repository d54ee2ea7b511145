"""Base classes: rows of the least-squares cost."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from wbc_controller.errors import ConfigurationError, MethodError
from wbc_controller.inverse_dynamics.method_calls import (
    array_from,
    arrays_from,
    arrays_of,
    call,
    checked,
    is_finite,
    raised,
    require_finite_result,
)
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.instruction import Instruction
from wbc_controller.inverse_dynamics.tasks.form import ReferenceForm
from wbc_controller.inverse_dynamics.tunable import Tunable
from wbc_controller.records import Array, Reference, frozen

Mask = Sequence[bool]  # True for selected axes
Gains = float | Sequence[float] | Array  # one number, or one per axis


def gains(values: Gains, size: int, key: str) -> Array:
    """Read a gain, () or (size,), with values for masked axes; errors begin with the key."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape not in ((), (size,)):
        raise ConfigurationError(
            f"{key} has {array.size} values; expected one number, or a list with one for each of the task's {size} axes"
        )
    return array


class Task(Tunable, ABC):
    """Control objective: rows of a least-squares problem in the decision variables, with weight and priority level.

    Settings override `weight`, `enabled` and `setpoint_duration`. Set `level` and `tolerance` before the controller is
    made. Constructors raise `ConfigurationError` for unknown names and lists of wrong length.
    """

    size: int  # before the mask
    level: int = 0  # priority level; 0 is the highest
    tolerance: Array | None = None  # deviation without cost, in the unit of the error, () or (size,)
    weight: float = 1.0
    enabled: bool = True  # at activation
    setpoint_duration: float = 1.0  # of the motion to a new setpoint, s
    unit: str = ""  # of the task error
    gain_names: tuple[str, ...] = ()  # each () or (size,); first the gain of the task error

    def __init__(self, name: str, mask: Mask) -> None:
        self.name = name
        self.rows = np.flatnonzero(np.asarray(mask))  # components selected by the mask, (k,)
        self._selects_all = len(self.rows) == len(mask)

    @property
    def full_name(self) -> str:
        """Kind and name, for errors."""
        return f"task {self.name!r}"

    @property
    def gains(self) -> Mapping[str, Array]:
        """Gains by name."""
        return {name: getattr(self, name) for name in self.gain_names}

    @property
    def form(self) -> ReferenceForm:
        """Form of the reference's position."""
        return ReferenceForm(vector=self.size)

    @property
    def dimension(self) -> int:
        """Number of rows in the cost."""
        return len(self.rows)

    @abstractmethod
    def rest(self, dynamics: Dynamics) -> Reference:
        """Return the default reference."""

    def band(self) -> Array:
        """Return the tolerance as half-width of the rows, (k,)."""
        if self.tolerance is None:
            return np.zeros(self.dimension)
        gain = getattr(self, self.gain_names[0]) if self.gain_names else 1.0
        return np.broadcast_to(self.tolerance * gain, (self.size,))[self.rows]


def rest_of(task: Task, dynamics: Dynamics) -> Reference:
    """Return `Task.rest`, checked (`method_calls`)."""
    reference, rate = call(task, "rest", dynamics), (task.form.rate_size,)
    if not isinstance(reference, Reference):
        raise MethodError(
            f"{task.full_name}: {type(task).__name__}.rest() returned {type(reference).__name__}, expected a Reference"
        )
    given = reference.position, reference.velocity, reference.acceleration
    arrays = arrays_of(task, "rest", given, ((task.form.size,), rate, rate))
    require_finite_result(task, "rest", *arrays)
    return Reference(*arrays)


class AccelerationTask(Task):
    """Task that makes a quantity x follow its reference by the choice of v̇.

    With the lowest derivative of x that depends on v̇, x⁽ⁿ⁾ = J v̇ + δ, and the drift δ, the task is

        J v̇ = x⁽ⁿ⁾* - δ

    in the least-squares sense. `MotionTask` defines x⁽ⁿ⁾* for x(q), and `RateTask` for x(q, v).
    """

    @abstractmethod
    def position(self, dynamics: Dynamics) -> Array:
        """Return x, in the form of the reference's position."""

    @abstractmethod
    def error(self, dynamics: Dynamics, position: Array) -> Array:
        """Return the displacement from x to a reference position, (size,)."""

    @abstractmethod
    def jacobian(self, dynamics: Dynamics) -> Array:
        """Return J, (size, nv)."""

    @abstractmethod
    def drift(self, dynamics: Dynamics) -> Array:
        """Return δ, (size,)."""

    @abstractmethod
    def right(self, dynamics: Dynamics, reference: Reference) -> tuple[Array, Array]:
        """Return x⁽ⁿ⁾* - δ and the error, both (size,)."""

    def instruction(self) -> Instruction | None:
        """Return the instruction for compiled code, only of a `MotionTask`; None to fill the rows in Python."""
        return None

    def rest(self, dynamics: Dynamics) -> Reference:
        """Return a reference at the present value."""
        still = frozen(np.zeros(self.form.rate_size))
        return Reference(frozen(array_from(self, "position", (self.form.size,), dynamics)), still, still)

    def equation(self, dynamics: Dynamics, reference: Reference) -> tuple[Array, Array, Array]:
        """Return the masked rows J (k, nv), b (k,) of J v̇ = b and the error (k,), as new arrays."""
        size, rows = self.size, self.rows
        right, error = self.right(dynamics, reference)
        right, error = checked(self, "right", right, (size,)), checked(self, "right", error, (size,))
        J = checked(self, "jacobian", self.jacobian(dynamics), (size, dynamics.model.nv))
        return (J, right, error) if self._selects_all else (J[rows], right[rows], error[rows])


def evaluate(task: AccelerationTask, dynamics: Dynamics, reference: Reference) -> None:
    """Check each method of a task (`method_calls`)."""
    size, k, nv = (task.size,), (task.dimension,), dynamics.model.nv
    array_from(task, "position", (task.form.size,), dynamics)
    array_from(task, "error", size, dynamics, reference.position)
    array_from(task, "jacobian", (task.size, nv), dynamics)
    array_from(task, "drift", size, dynamics)
    if isinstance(task, MotionTask):
        array_from(task, "velocity", size, dynamics)
    arrays_from(task, "right", (size, size), dynamics, reference)
    arrays_from(task, "equation", ((*k, nv), k, k), dynamics, reference)


def task_motion(task: AccelerationTask, dynamics: Dynamics, reference: Reference) -> tuple[Array, Array, Array]:
    """Return `AccelerationTask.equation`, checked (`method_calls`)."""
    k = (task.dimension,)
    try:
        equation = task.equation(dynamics, reference)
        J, right, error = arrays_of(task, "equation", equation, ((*k, dynamics.model.nv), k, k))
    except Exception as failure:
        evaluate(task, dynamics, reference)
        raise raised(task, "equation", failure) from failure
    wanted = reference.position, reference.velocity, reference.acceleration
    if not (is_finite(J) and is_finite(right)) and all(map(is_finite, wanted)):
        evaluate(task, dynamics, reference)
    return J, right, error


class Efforts(Protocol):
    """Torques and contact forces as affine functions of the decision variables x, (n,)."""

    @property
    def torque_map(self) -> tuple[Array, Array]:
        """R (na, n) and r (na,) of τ = R x + r, N·m."""

    def force_map(self, contact: str) -> Array | None:
        """Return R (k, n) of the contact force f = R x, in contact axes; None for an inactive contact."""


class EffortTask(Task):
    """Task on contact forces or torques, without gains; velocity and acceleration of the reference are ignored."""

    def __init__(self, name: str, mask: Mask, target: Array) -> None:
        super().__init__(name, mask)
        self.target = target  # default reference, (size,)

    def rest(self, dynamics: Dynamics) -> Reference:
        """Return the target."""
        still = np.zeros(self.size)
        return Reference(self.target, still, still)

    @abstractmethod
    def equation(self, efforts: Efforts, reference: Reference) -> tuple[Array, Array] | None:
        """Return the rows R x = r in the decision variables x, R (k, n), r (k,); None for an inactive contact."""


def equation_of(task: EffortTask, efforts: Efforts, reference: Reference, n: int) -> tuple[Array, Array] | None:
    """Return `EffortTask.equation`, checked (`method_calls`)."""
    equation = call(task, "equation", efforts, reference)
    if equation is None:
        return None
    k = task.dimension
    rows, right = arrays_of(task, "equation", equation, ((k, n), (k,)))
    if not (is_finite(rows) and is_finite(right)) and is_finite(reference.position):
        require_finite_result(task, "equation", rows, right)
    return rows, right


class MotionTask(AccelerationTask):
    """Task on a quantity x(q): PD feedback on the task error plus feed-forward.

    With ẋ = J v and ẍ = J v̇ + J̇v, the desired acceleration is

        ẍ* = ẍ_ref + D (ẋ_ref - ẋ) + K e

    with the error e from x to x_ref.
    """

    gain_names = ("stiffness", "damping")
    stiffness: Array  # K, 1/s², () or (size,)
    damping: Array  # D, 1/s, () or (size,)

    def __init__(self, name: str, mask: Mask, *, stiffness: Gains = 100.0, damping: Gains | None = None) -> None:
        """Make a task with a mask, (size,), and gains; the default damping is critical, 2√K."""
        super().__init__(name, mask)
        self.stiffness = gains(stiffness, len(mask), f"tasks.{name}.stiffness")
        critical = 2.0 * np.sqrt(self.stiffness)
        self.damping = gains(critical if damping is None else damping, len(mask), f"tasks.{name}.damping")

    @abstractmethod
    def velocity(self, dynamics: Dynamics) -> Array:
        """Return ẋ, (size,)."""

    def right(self, dynamics: Dynamics, reference: Reference) -> tuple[Array, Array]:
        """Return ẍ* - J̇v and the error."""
        shape = (self.size,)
        error = checked(self, "error", self.error(dynamics, reference.position), shape)
        velocity = checked(self, "velocity", self.velocity(dynamics), shape)
        wanted = reference.acceleration + self.damping * (reference.velocity - velocity) + self.stiffness * error
        return wanted - checked(self, "drift", self.drift(dynamics), shape), error


class RateTask(AccelerationTask):
    """Task on a quantity x(q, v) with ẋ = J v̇ + δ: first-order feedback on the task error e = x_ref - x.

        ẋ* = ẋ_ref + k e

    Undisturbed, e decays as exp(-k t).
    """

    gain_names = ("gain",)

    def __init__(self, name: str, mask: Mask, *, gain: Gains, key: str) -> None:
        """Make a task with a mask (size,) and a gain k; errors begin with the key."""
        super().__init__(name, mask)
        self.gain = gains(gain, len(mask), f"tasks.{name}.{key}")  # k, 1/s, () or (size,)

    def error(self, dynamics: Dynamics, position: Array) -> Array:
        """Return x_ref - x, (size,)."""
        return position - checked(self, "position", self.position(dynamics), (self.form.size,))

    def right(self, dynamics: Dynamics, reference: Reference) -> tuple[Array, Array]:
        """Return ẋ* - δ and the error."""
        shape = (self.size,)
        error = checked(self, "error", self.error(dynamics, reference.position), shape)
        return reference.velocity + self.gain * error - checked(self, "drift", self.drift(dynamics), shape), error
