"""Solution from the minimizer."""

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np

from wbc_controller.inverse_dynamics.formulation.cost import Errors
from wbc_controller.inverse_dynamics.formulation.formulation import Formulation
from wbc_controller.inverse_dynamics.formulation.layout import Layout
from wbc_controller.inverse_dynamics.formulation.problem import FORCE_UNIT, Answer, Level, Residuals
from wbc_controller.records import Array, LevelReport, References, Solution, frozen_mapping

_BINDING = 1.0e-5  # relative distance from a bound
_LARGEST = 1.0e9  # infinite bounds are never binding
_NONE: Mapping[str, Any] = MappingProxyType({})


class _LazySolution(Solution):
    """Solution from unchanged parts of the layout."""

    _layout: Layout
    _labels: Sequence[tuple[str, str, float]]
    _levels: Sequence[Level]
    _contact_rows: Array | None
    _answer: Answer
    _residuals: Residuals
    _errors: Sequence[Errors]

    @cached_property
    def forces(self) -> Mapping[str, Array]:
        forces = FORCE_UNIT * self._residuals.value[self._layout.forces]
        forces.setflags(write=False)
        return MappingProxyType({place.contact.name: forces[place.motion] for place in self._layout.places})

    @cached_property
    def residuals(self) -> Mapping[str, float]:
        """Largest violation in each group of constraints, with redundant contact directions."""
        equalities, contact_rows = self._residuals.equalities.tolist(), self._layout.mechanism.start
        rows = self._contact_rows
        if rows is not None:
            missed = rows[:, :-1] @ self._residuals.value[: rows.shape[1] - 1] - rows[:, -1]
            equalities[:contact_rows] = np.abs(missed).tolist()
        return MappingProxyType(
            {
                "equations_of_motion": max(equalities[contact_rows:], default=0.0),
                "contact_motion": max(equalities[:contact_rows], default=0.0),
                "inequalities": max(0.0, -self._residuals.least_room),
            }
        )

    @cached_property
    def task_errors(self) -> Mapping[str, float]:
        """Norms of the task errors; of effort tasks at the solution."""
        errors: dict[str, Array] = {}
        for places, values in self._errors:
            errors |= {name: values[place] for name, place in places}
        return MappingProxyType({name: math.sqrt(error.dot(error)) for name, error in errors.items()})

    @cached_property
    def binding(self) -> Mapping[str, float]:
        """Binding constraints with multipliers per SI unit of the bound."""
        residuals, multipliers, labels = self._residuals, self._answer.multipliers, self._labels
        # Quick test: the norm bounds each value.
        value = residuals.value
        if residuals.least_room > 2.0 * _BINDING * (1.0 + math.sqrt(value.dot(value))):
            return _NONE
        room = residuals.room
        bounds = np.abs([value - room[0], value + room[1]])
        sides, rows = (room <= _BINDING * np.clip(bounds, 1.0, _LARGEST)).nonzero()
        found: dict[str, float] = {}
        for side, row in zip(sides.tolist(), rows.tolist(), strict=True):
            name, unit = labels[row][side], labels[row][2]
            if name:
                found[name] = found.get(name, 0.0) + abs(float(multipliers[row])) / unit
        return MappingProxyType(found)

    @cached_property
    def levels(self) -> Sequence[LevelReport]:
        answer = self._answer
        if answer.levels or answer.cost is None:
            return answer.levels
        seconds = self.stage_seconds.get("solve", 0.0)
        return (LevelReport(self._levels[0].tasks, answer.cost, answer.iterations, seconds),)


def unpack(
    formulation: Formulation,
    layout: Layout,
    answer: Answer,
    references: References,
    stages: Mapping[str, float] = _NONE,
) -> Solution:
    """Make the solution of an answer with residuals, or raise ValueError; `stages` are durations in s."""
    residuals = answer.residuals
    if residuals is None:
        raise ValueError(f"the answer {answer.status!r} has no residuals")
    value = residuals.value
    value.setflags(write=False)
    residuals.outputs.setflags(write=False)
    formulation.add_effort_errors(value[: layout.problem.n])
    wrenches = references.external_wrenches
    solution = object.__new__(_LazySolution)
    vars(solution).update(  # faster than the constructor of a frozen record
        v_dot=value[: formulation.model.nv],
        tau=residuals.outputs,
        relaxed=answer.relaxed,
        iterations=answer.iterations,
        stage_seconds=MappingProxyType(stages),
        external_wrenches=frozen_mapping(wrenches) if wrenches else _NONE,
        disturbance=references.disturbance,
        _layout=layout,
        _labels=layout.labels,
        _levels=layout.levels,
        _contact_rows=layout.contact_rows,
        _answer=answer,
        _residuals=residuals,
        _errors=formulation.task_errors,
    )
    return solution
