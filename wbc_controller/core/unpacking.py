"""From the minimizer of the quadratic program to the solution, with residuals and what binds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import TypedDict

import numpy as np

from wbc_controller.core.formulation import Formulation
from wbc_controller.core.layout import FORCE_UNIT, Layout
from wbc_controller.core.problem import Residuals
from wbc_controller.records import Array, References, freeze, frozen_mapping

#: Distance from a bound, relative to its size (at least 1), within which a constraint counts as binding.
_BINDING = 1.0e-5
#: Largest size of a bound, so that one at infinity is never binding.
_LARGEST = 1.0e9
_NONE: Mapping[str, Array] = MappingProxyType({})


class Unpacked(TypedDict):
    """What of a `Solution` follows from the minimizer."""

    v_dot: Array
    tau: Array
    forces: Mapping[str, Array]
    residuals: Mapping[str, float]
    task_errors: Mapping[str, float]
    binding: Mapping[str, float]
    external_wrenches: Mapping[str, Array]


def unpack(
    formulation: Formulation,
    layout: Layout,
    x: Array,
    multipliers: Array,
    residuals: Residuals,
    references: References,
) -> Unpacked:
    """Read a minimizer.

    Args:
        formulation: that built the problem.
        layout: with the problem, as it was given to the solver.
        x: the minimizer, (n,).
        multipliers: of the bounds of x and the rows of C, (n + m_in,), as in `solvers.Answer`.
        residuals: of the problem's constraints at x.
        references: that the problem was built for.
    """
    nv, n = formulation.model.nv, len(x)
    equalities, start = residuals.equalities.tolist(), layout.mechanism.start  # so few that a list is faster
    torques = residuals.value[n + layout.torque.start : n + layout.torque.stop]
    x = freeze(x)
    forces = freeze(FORCE_UNIT * x[nv:])
    return {
        "v_dot": x[:nv],
        "tau": freeze(torques + layout.torque_bias),
        "forces": MappingProxyType({place.contact.name: forces[place.motion] for place in layout.places}),
        "residuals": MappingProxyType(
            {
                "equations_of_motion": max(equalities[start:], default=0.0),
                "contact_motion": max(equalities[:start], default=0.0),
                "inequalities": max(0.0, -residuals.least_room),
            }
        ),
        "task_errors": MappingProxyType(_task_errors(formulation, layout, x, references)),
        "binding": MappingProxyType(_binding(layout, residuals, multipliers)),
        "external_wrenches": frozen_mapping(references.external_wrenches) if references.external_wrenches else _NONE,
    }


def _task_errors(formulation: Formulation, layout: Layout, x: Array, references: References) -> dict[str, float]:
    """Of tasks on accelerations how far the state is from the reference; of those on efforts how far the answer is."""
    errors = formulation.task_errors
    for task in formulation.effort_tasks:
        if references.weights.get(task.name, 0.0) > 0.0:
            equation = task.equation(layout, references.tasks[task.name])
            if equation is not None:
                errors[task.name] = float(np.linalg.norm(equation[0] @ x - equation[1]))
    return errors


def _binding(layout: Layout, residuals: Residuals, multipliers: Array) -> dict[str, float]:
    """The inequalities that hold with equality, and what each costs: its multiplier, per unit of its bound."""
    # Mostly none does, and that is seen at once: no bound that is close to its value is larger than about the largest,
    # and none of these is larger than their norm.
    if residuals.least_room > 2.0 * _BINDING * (1.0 + math.sqrt(residuals.value.dot(residuals.value))):
        return {}
    size = np.minimum(np.maximum(np.abs(layout.problem.bounds), 1.0), _LARGEST)
    sides, rows = (residuals.room <= _BINDING * size).nonzero()
    found: dict[str, float] = {}
    for side, row in zip(sides.tolist(), rows.tolist(), strict=True):
        name, unit = layout.labels[row][side], layout.labels[row][2]
        if name:
            found[name] = found.get(name, 0.0) + abs(float(multipliers[row])) / unit
    return found
