"""From the minimizer of the quadratic program to the solution, with residuals and what binds."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from wbc_controller.core.formulation import Formulation
from wbc_controller.core.model import RobotModel
from wbc_controller.core.problem import FORCE_UNIT, Layout
from wbc_controller.records import Array, References, Solution, frozen, frozen_mapping

#: Distance from a bound, relative to its size (at least 1), within which a constraint counts as binding.
_BINDING = 1.0e-5


def unpack(
    formulation: Formulation, layout: Layout, x: Array, multipliers: Array, references: References, iterations: int
) -> Solution:
    """Read a minimizer.

    Args:
        formulation: that built the problem.
        layout: with the problem, as it was given to the solver.
        x: the minimizer, (n,).
        multipliers: of the bounds of x and the rows of C, (n + m_in,), as in `solvers.Answer`.
        references: that the problem was built for.
        iterations: the solver's own count.
    """
    problem, model = layout.problem, formulation.model
    v_dot, f = x[: model.nv], FORCE_UNIT * x[model.nv :]
    generalized = formulation.dynamics.M @ v_dot + formulation.bias(references) - layout.J.T @ f  # = Sᵀτ + Cᵀλ
    motion = problem.A @ x - problem.b
    residuals = {
        "equations_of_motion": _largest(model.actuation.unactuated(generalized)),
        "contact_motion": _largest(motion[layout.mechanism.stop :]),
        "inequalities": max(0.0, problem.violation(x)),
    }
    forces = {
        contact.name: frozen(FORCE_UNIT * x[columns])
        for contact, columns in zip(layout.contacts, layout.forces, strict=True)
    }
    return Solution(
        v_dot=frozen(v_dot),
        tau=frozen(model.actuation.torques(generalized)),
        forces=frozen_mapping(forces),
        residuals=frozen_mapping(residuals),
        task_errors=frozen_mapping(_task_errors(formulation, layout, x, references)),
        binding=frozen_mapping(_binding(layout, model, x, multipliers)),
        iterations=iterations,
        external_wrenches=frozen_mapping(references.external_wrenches),
    )


def _task_errors(formulation: Formulation, layout: Layout, x: Array, references: References) -> dict[str, float]:
    """Of tasks on accelerations how far the state is from the reference; of those on efforts how far the answer is."""
    errors = formulation.task_errors
    for task in formulation.effort_tasks:
        if references.weights.get(task.name, 0.0) > 0.0:
            equation = task.equation(layout, references.tasks[task.name])
            if equation is not None:
                errors[task.name] = float(np.linalg.norm(equation[0] @ x - equation[1]))
    return errors


def _binding(layout: Layout, model: RobotModel, x: Array, multipliers: Array) -> Mapping[str, float]:
    """The inequalities that hold with equality, and what each costs: its multiplier, per unit of its bound."""
    problem = layout.problem
    value = np.concatenate([x, problem.C @ x])
    lower = np.concatenate([problem.x_lower, problem.lower])
    upper = np.concatenate([problem.x_upper, problem.upper])
    at_lower, at_upper = _at(value, lower), _at(value, upper)
    if not (at_lower.any() or at_upper.any()):
        return {}
    cost = np.abs(multipliers)
    n = len(x)
    found: dict[str, float] = {}

    def add(name: str, start: int, stop: int, at: np.ndarray, unit: float) -> None:
        if at[start:stop].any():
            found[name] = float(np.sum(cost[start:stop][at[start:stop]])) / unit

    for i, actuator in enumerate(model.actuators):
        row = n + layout.torque.start + i
        add(f"torque:{actuator}:lower", row, row + 1, at_lower, 1.0)
        add(f"torque:{actuator}:upper", row, row + 1, at_upper, 1.0)
    for contact, rows in zip(layout.contacts, layout.cones, strict=True):
        add(f"cone:{contact.name}", n + rows.start, n + rows.stop, at_upper, FORCE_UNIT)
    for joint, column in zip(model.joints, layout.joints.tolist(), strict=True):
        add(f"motion:{joint}:lower", column, column + 1, at_lower, 1.0)
        add(f"motion:{joint}:upper", column, column + 1, at_upper, 1.0)
    for contact, columns in zip(layout.contacts, layout.forces, strict=True):
        for kind, first, last in contact.bound_groups:
            start, stop = columns.start + first, columns.start + last
            add(f"{kind}:{contact.name}:lower", start, stop, at_lower, FORCE_UNIT)
            add(f"{kind}:{contact.name}:upper", start, stop, at_upper, FORCE_UNIT)
    for limit, rows in zip(layout.row_limits, layout.limits, strict=True):
        for row, name in enumerate(limit.names, n + rows.start):
            add(name, row, row + 1, at_lower | at_upper, 1.0)
    return found


def _at(value: Array, bound: Array) -> np.ndarray:
    near = np.abs(value - bound) <= _BINDING * np.maximum(1.0, np.abs(bound))
    return np.asarray(near & np.isfinite(bound))


def _largest(values: Array) -> float:
    return float(np.max(np.abs(values), initial=0.0))
