"""Construction of user-defined tasks, contacts and limits."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar

import numpy as np

from wbc_controller.errors import ConfigurationError, MethodError
from wbc_controller.inverse_dynamics import method_calls
from wbc_controller.inverse_dynamics.contacts import AnchoredContact, Contact
from wbc_controller.inverse_dynamics.contacts.contact import anchor_of, points_of
from wbc_controller.inverse_dynamics.contacts.contact import evaluate as evaluate_contact
from wbc_controller.inverse_dynamics.formulation.formulation import Formulation
from wbc_controller.inverse_dynamics.limits import RowLimit
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.tasks import AccelerationTask, EffortTask, Task
from wbc_controller.inverse_dynamics.tasks.task import equation_of, rest_of
from wbc_controller.inverse_dynamics.tasks.task import evaluate as evaluate_task

_Made = TypeVar("_Made", Task, Contact, RowLimit)


def make_user_objects(
    makers: Iterable[Callable[[RobotModel], _Made]], model: RobotModel, kind: Any, key: str, taken: Sequence[str]
) -> list[_Made]:
    """Create user objects, and check their classes, names and attributes; `taken` are names in use."""
    check: Any = {Task: _check_task, Contact: _check_contact, RowLimit: _check_limit}[kind]
    made: list[_Made] = []
    expected = f"{key} = {makers!r}: must be a list of classes or functions that take the robot's model"
    try:
        all_makers = tuple(makers)
    except Exception as error:
        raise ConfigurationError(expected) from error
    if not all(map(callable, all_makers)):
        raise ConfigurationError(expected)
    for make in all_makers:
        try:
            one = make(model)
        except ConfigurationError:
            raise
        except Exception as error:
            raise ConfigurationError(f"{key}: {make!r} raised {type(error).__name__}: {error}") from error
        if not isinstance(one, kind):
            raise ConfigurationError(
                f"{key}: {make!r} returned a {type(one).__name__}, expected a {kind.__name__} for the robot's model"
            )
        name = getattr(one, "name", None)
        if not isinstance(one, RowLimit) and not isinstance(name, str):
            raise ConfigurationError(f"{key}: {type(one).__name__}.name is {name!r}, expected a string")
        if name is not None and name in (*taken, *(other.name for other in made if not isinstance(other, RowLimit))):
            raise ConfigurationError(f"{key}: duplicate name {name!r}; use different names")
        check(one)
        made.append(one)
    return made


def _check_task(task: Task) -> None:
    size = _attribute(task, "size")
    _require(task, "size", "an integer above 0", isinstance(size, int) and size > 0)
    rows = _attribute(task, "rows")
    fits = isinstance(rows, np.ndarray) and rows.ndim == 1 and rows.dtype.kind == "i"
    fits = fits and len(rows) > 0 and bool((rows >= 0).all() and (rows < size).all())
    _require(task, "rows", f"indices below size = {size}, from a mask that selects at least one axis", fits)
    _require(task, "weight", "a finite number of at least 0", _is_number(task.weight))
    _require(task, "level", "an integer of at least 0", isinstance(task.level, int) and task.level >= 0)
    _require(task, "enabled", "True or False", isinstance(task.enabled, bool | np.bool_))
    _require(task, "setpoint_duration", "a finite time of at least 0 s", _is_number(task.setpoint_duration))
    for name in task.gain_names:
        _require(task, name, f"finite numbers of shape () or ({size},)", _fits(task, name))
    if task.tolerance is not None:
        fits = _fits(task, "tolerance") and bool((np.asarray(task.tolerance) >= 0.0).all())
        _require(task, "tolerance", f"finite numbers of at least 0, shape () or ({size},)", fits)
    if isinstance(task, EffortTask):
        method_calls.checked(task, "__init__", task.target, (task.form.size,))


def _check_contact(contact: Contact) -> None:
    size = contact.size
    _require(contact, "size", "an integer above 0", isinstance(size, int) and size > 0)
    _require(contact, "enabled", "True or False", isinstance(contact.enabled, bool | np.bool_))
    basis, cone, metric = (_attribute(contact, name) for name in ("basis", "cone", "metric"))
    _require(contact, "basis", f"finite numbers of shape (6, {size})", _is_matrix(basis, (6, size)))
    rows = len(cone) if isinstance(cone, np.ndarray) and cone.ndim == 2 else 0
    _require(contact, "cone", f"finite numbers of shape (rows, {size})", _is_matrix(cone, (rows, size)))
    _require(contact, "metric", f"finite numbers of shape ({size},)", _is_matrix(metric, (size,)))
    for name in ("damping", "ramp", "stiffness") if isinstance(contact, AnchoredContact) else ("damping", "ramp"):
        _require(contact, name, "a finite number of at least 0", _is_number(getattr(contact, name)))
    _require(contact, "bound_groups", "a tuple of groups", isinstance(contact.bound_groups, tuple | list))
    for group in contact.bound_groups:
        fits = isinstance(group, tuple | list) and len(group) == 3 and isinstance(group[0], str)
        fits = fits and all(isinstance(index, int) for index in group[1:]) and 0 <= group[1] < group[2] <= size
        _require(contact, "bound_groups", f"a name and two indices from 0 to {size}, in rising order", fits, group)


def _check_limit(limit: RowLimit) -> None:
    for name in ("kind", "unit"):
        _require(limit, name, "a string", isinstance(_attribute(limit, name), str))
    names = _attribute(limit, "names")
    fits = isinstance(names, tuple | list) and len(names) > 0 and all(isinstance(name, str) for name in names)
    _require(limit, "names", "a tuple with one string per row", fits)


def _attribute(owner: Task | Contact | RowLimit, name: str) -> Any:
    try:
        return getattr(owner, name)
    except AttributeError as error:
        raise ConfigurationError(f"{type(owner).__name__}: missing attribute {name!r}; set it in the class") from error


def _require(owner: Task | Contact | RowLimit, name: str, expected: str, fits: bool, *part: Any) -> None:
    """Raise an error unless an attribute, or a part of it, fits."""
    if not fits:
        value = part[0] if part else getattr(owner, name)
        raise ConfigurationError(f"{owner.full_name}: {type(owner).__name__}.{name} is {value!r}, expected {expected}")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.floating | np.integer) and bool(0.0 <= value < np.inf)


def _fits(task: Task, name: str) -> bool:
    value = getattr(task, name)
    return _is_matrix(value, ()) or _is_matrix(value, (task.size,))


def _is_matrix(value: Any, shape: tuple[int, ...]) -> bool:
    if isinstance(value, np.ma.MaskedArray):
        return False
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        return False
    return array.dtype.kind in "iuf" and array.shape == shape and bool(np.isfinite(array).all())


def evaluate_methods(
    formulation: Formulation, tasks: Sequence[Task], contacts: Sequence[Contact], limits: Sequence[RowLimit]
) -> None:
    """Evaluate each method once, at rest in the nominal posture, and check its return value."""
    model, dynamics = formulation.model, Dynamics(formulation.model)
    dynamics.compute(model.configuration(model.posture), np.zeros(model.nv))
    for task in tasks:
        reference = rest_of(task, dynamics)
        if isinstance(task, AccelerationTask):
            evaluate_task(task, dynamics, reference)
        elif isinstance(task, EffortTask):
            layout = formulation.layout(tuple(formulation.contacts))
            equation_of(task, layout, reference, layout.problem.n)
    for contact in contacts:
        evaluate_contact(contact, dynamics)
        for activation in (0.5, 1.0):
            method_calls.bounds_from(contact, "bounds", contact.size, activation)
        points_of(contact, dynamics)
        method_calls.array_from(contact, "wrench_in_world", (6,), dynamics, np.zeros(contact.size))
        if isinstance(contact, AnchoredContact) and contact.stiffness > 0.0:
            method_calls.array_from(contact, "displacement", (contact.size,), dynamics, anchor_of(contact, dynamics))
    for limit in limits:
        _evaluate_limit(limit, dynamics, formulation.period)


def _evaluate_limit(limit: RowLimit, dynamics: Dynamics, period: float) -> None:
    count = len(limit.names)
    rows = np.full((count, dynamics.model.nv), np.nan)
    lower, upper = np.full(count, np.nan), np.full(count, np.nan)
    method_calls.call(limit, "fill", dynamics, period, rows, lower, upper)
    method_calls.require_finite(limit, "fill", "rows", rows)
    method_calls.require_bounds(limit, "fill", lower, upper)
    if len(limit.names) != count:
        raise MethodError(
            f"{limit.full_name}: {type(limit).__name__}.fill() changed the number of names from {count} to "
            f"{len(limit.names)}; it must be constant"
        )
