"""From the minimizer of the quadratic program to the solution, with residuals and binding constraints."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from wbc_controller.core.program.cost import Errors
from wbc_controller.core.program.formulation import Formulation
from wbc_controller.core.program.layout import FORCE_UNIT, ContactPlace, Layout
from wbc_controller.core.program.problem import Residuals
from wbc_controller.records import Array, LevelReport, References, Solution, freeze, frozen_mapping

#: Distance from a bound, relative to its size (at least 1), within which a constraint counts as binding.
_BINDING = 1.0e-5
#: Largest magnitude of a bound in this comparison, so that an infinite bound is never binding.
_LARGEST = 1.0e9
_NONE: Mapping[str, Any] = MappingProxyType({})


class _Read(Mapping[str, Any]):
    """A read-only mapping that is computed on first access, as most are never read and would delay the torques."""

    __slots__ = ("_made", "_make", "_parts")

    def __init__(self, make: Callable[..., dict[str, Any]], parts: tuple[Any, ...]) -> None:
        """Store the function and its arguments, which must not be modified afterwards."""
        self._make = make
        self._parts = parts
        self._made: dict[str, Any] | None = None

    def _all(self) -> dict[str, Any]:
        if self._made is None:
            self._made = self._make(*self._parts)
        return self._made

    def __getitem__(self, key: str) -> Any:
        return self._all()[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._all())

    def __len__(self) -> int:
        return len(self._all())

    def __repr__(self) -> str:
        return repr(self._all())


def unpack(
    formulation: Formulation,
    layout: Layout,
    x: Array,
    multipliers: Array,
    residuals: Residuals,
    references: References,
    iterations: int = 0,
    levels: tuple[LevelReport, ...] = (),
    relaxed: tuple[str, ...] = (),
    stages: Mapping[str, float] = _NONE,
) -> Solution:
    """Make a solution of a minimizer.

    Args:
        formulation: the formulation that built the problem.
        layout: with the problem, as it was given to the solver.
        x: the minimizer, (n,).
        multipliers: of the bounds of x and the rows of C, (n + m_in,), as in `solvers.Answer`.
        residuals: residuals of the problem's constraints at x.
        references: the references for which the problem was built.
        iterations: the solver's own count.
        levels: the quadratic programs that were solved.
        relaxed: groups in which a bound is missed, and lower levels that failed.
        stages: time spent in each stage, in s.
    """
    nv, n, bias = formulation.model.nv, len(x), layout.torque_bias
    tau = residuals.found[n : n + len(bias)] + bias
    x.setflags(write=False)
    tau.setflags(write=False)
    errors = formulation.task_errors
    for task in formulation.effort_tasks:
        if references.weights.get(task.name, 0.0) > 0.0:
            equation = task.equation(layout, references.tasks[task.name])
            if equation is not None:
                errors += (Errors((), x, {task.name: equation[0] @ x - equation[1]}),)
    return Solution(
        x[:nv],
        tau,
        _Read(_forces, (layout.places, x[nv:])),
        _Read(_violations, (residuals, layout.mechanism.start)),
        _Read(_norms, (errors,)),
        _Read(_binding, (layout.labels, residuals, multipliers)),
        iterations,
        levels,
        relaxed,
        MappingProxyType(stages),
        frozen_mapping(references.external_wrenches) if references.external_wrenches else _NONE,
        references.disturbance,
    )


def _forces(places: Sequence[ContactPlace], f: Array) -> dict[str, Array]:
    """The force of each contact, (k,) in N and N·m."""
    forces = freeze(FORCE_UNIT * f)
    return {place.contact.name: forces[place.motion] for place in places}


def _violations(residuals: Residuals, contact_rows: int) -> dict[str, float]:
    """The largest violation in each group of constraints."""
    equalities = residuals.equalities.tolist()
    return {
        "equations_of_motion": max(equalities[contact_rows:], default=0.0),
        "contact_motion": max(equalities[:contact_rows], default=0.0),
        "inequalities": max(0.0, -residuals.least_room),
    }


def _norms(parts: Sequence[Errors]) -> dict[str, float]:
    """Norms of the task errors: of the state for acceleration tasks, of the solution for effort tasks."""
    errors: dict[str, Array] = {}
    for places, values, others in parts:
        errors |= {name: values[place] for name, place in places} | others
    return {name: math.sqrt(error.dot(error)) for name, error in errors.items()}


def _binding(labels: Sequence[tuple[str, str, float]], residuals: Residuals, multipliers: Array) -> dict[str, float]:
    """The binding constraints, each with its multiplier per SI unit of its bound."""
    # In most cycles none is binding. A quick test: a bound close to its value has about the magnitude of that value,
    # which the norm of all values bounds, so the tolerance below covers every bound.
    value = residuals.value
    if residuals.least_room > 2.0 * _BINDING * (1.0 + math.sqrt(value.dot(value))):
        return {}
    room = residuals.room
    bounds = np.abs([value - room[0], value + room[1]])
    sides, rows = (room <= _BINDING * np.clip(bounds, 1.0, _LARGEST)).nonzero()
    found: dict[str, float] = {}
    for side, row in zip(sides.tolist(), rows.tolist(), strict=True):
        name, unit = labels[row][side], labels[row][2]
        if name:
            found[name] = found.get(name, 0.0) + abs(float(multipliers[row])) / unit
    return found
