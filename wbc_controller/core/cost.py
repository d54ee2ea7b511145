"""The cost of one priority: the weighted rows of its tasks, and the regularization."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from wbc_controller.core.dynamics import Dynamics
from wbc_controller.core.layout import FORCE_UNIT, Layout
from wbc_controller.core.model import RobotModel
from wbc_controller.core.places import as_slice
from wbc_controller.core.problem import Level, Quadratic, Squares
from wbc_controller.core.tasks import AccelerationTask, EffortTask, Task
from wbc_controller.records import Array, References

#: Length that makes a rate of angular momentum comparable to one of linear momentum in the regularization, m.
ROTATION_LENGTH = 0.1


@dataclass(slots=True)
class _Plan:
    """Where the cost of a level stands, for one set of made contacts and the tasks that weigh something.

    Attributes:
        level: with the cost that is to be posed.
        squares: what that is made of.
        kept: the rows of tasks.
        scale: √w of these, (k, 1).
        rows: each task with rows, and the places of its J and its right side.
        momentum: the same places of the momentum's rate; None where the base does not move.
        single: each task on single accelerations; by what its right side makes the target and, squared, the constant;
            and their columns.
    """

    level: Level
    squares: Squares
    kept: Array
    scale: Array
    rows: list[tuple[AccelerationTask, Array, Array]]
    momentum: tuple[Array, Array] | None
    single: list[tuple[AccelerationTask, Array, Array, np.ndarray | slice]]


class LevelCost:
    """Fills one `Level`: ½ Σ wᵢ ‖Rᵢ x - rᵢ‖² + ½ ε_a (‖q̈‖² + ‖ḣ_G / m‖²) + ½ ε_f ‖f‖².

    Attributes:
        level: the priority.
        rows: largest number of rows that it fills.
        errors: error of each acceleration task that took part in the last cycle.
    """

    def __init__(
        self,
        level: int,
        tasks: Sequence[Task],
        model: RobotModel,
        *,
        last: bool,
        regularization_acceleration: float,
        regularization_force: float,
    ) -> None:
        """Make a cost.

        Args:
            level: the priority.
            tasks: all tasks of the controller; those of the level take part.
            model: the robot's model.
            last: whether no level is below, so that nothing has to be kept.
            regularization_acceleration: ε_a.
            regularization_force: ε_f.
        """
        own = [task for task in tasks if task.level == level]
        self.level = level
        self.errors: dict[str, Array] = {}
        exact = [task for task in own if isinstance(task, AccelerationTask) and task.tolerance is None]
        # Rows that are single accelerations enter the diagonal alone, unless a level below has to keep them as rows, or
        # another task has some of them there.
        self._single: list[AccelerationTask] = []
        free = np.ones(model.nv, dtype=np.bool_)
        for task in exact:
            if last and task.columns is not None and free[task.columns].all():
                self._single.append(task)
                free[task.columns] = False
        self._exact = [task for task in exact if task not in self._single]
        self._others = [task for task in own if task not in exact]
        self._model = model
        self._last = last
        self._base = 6 if model.floating_base else 0
        self._regularization = (regularization_acceleration, regularization_force * FORCE_UNIT**2)
        scale = np.repeat([1.0, 1.0 / ROTATION_LENGTH], 3) * (regularization_acceleration**0.5 / model.mass)
        self._momentum_slack = scale**-2
        self._first = level == min(task.level for task in tasks)
        self.rows = sum(task.dimension for task in self._exact) + 6
        self._weights: dict[str, float] = {}
        self._plans: dict[tuple[str, ...], _Plan] = {}

    def fill(self, layout: Layout, dynamics: Dynamics, references: References) -> Level:
        """Pose the cost of one cycle.

        Args:
            layout: with the equations of motion filled.
            dynamics: the snapshot.
            references: what is wanted, and how much.
        """
        wanted, weights = references.tasks, references.weights
        if weights != self._weights:
            self._weights = dict(weights)
            self._plans.clear()
        plan = self._plans.get(layout.key)
        if plan is None:
            plan = self._plans[layout.key] = self._plan(layout, weights)
        errors = self.errors = {}
        for task, rows, right in plan.rows:
            rows[...], right[...], errors[task.name] = task.equation(dynamics, wanted[task.name])
        if plan.momentum is not None:  # ḣ_G, for a base that moves
            rows, right = plan.momentum
            rows[...] = dynamics.centroidal_matrix
            np.negative(dynamics.centroidal_drift, out=right)
        squares = plan.squares
        squares.constant = 0.0
        for task, minus_share, rest, columns in plan.single:
            asked, errors[task.name] = task.right(dynamics, wanted[task.name])
            squares.minus_target[columns] = minus_share * asked
            squares.constant += 0.5 * float((rest * asked).dot(asked))
        plan.level.cost.pose(squares)
        if self._last and not self._others:
            return plan.level  # of which nothing changes but its cost
        level = replace(plan.level)
        if not self._last:
            level.kept = plan.scale * plan.kept
        self._add_others(level, layout, dynamics, references)
        return level

    def _plan(self, layout: Layout, weights: Mapping[str, float]) -> _Plan:
        """Lay out the rows of the tasks that take part. What NaN weighs does: it is found later."""
        problem, nv, n, base = layout.problem, self._model.nv, layout.problem.n, self._base
        taking_part = [task for task in self._exact if not weights.get(task.name, 0.0) <= 0.0]
        count = sum(task.dimension for task in taking_part) + base
        # The first level has its rows above the equalities: the solver reads both.
        top, stop = problem.room - count, problem.room + len(problem.b)
        whole = problem.memory[top:stop] if self._first else np.zeros((count, n + 1))
        stack = whole[:count]
        stack[:] = 0.0
        slack, rows, end = np.empty(count), [], 0
        for task in taking_part:
            start, end = end, end + task.dimension
            slack[start:end] = 1.0 / weights[task.name]
            rows.append((task, stack[start:end, :nv], stack[start:end, n]))
        slack[end:] = self._momentum_slack[: count - end]
        momentum = (stack[end:, :nv], stack[end:, n]) if base else None
        single = [task for task in self._single if not weights.get(task.name, 0.0) <= 0.0]
        diagonal = np.empty(n - base)
        diagonal[: nv - base], diagonal[nv - base :] = self._regularization
        entries = []
        for task in single:
            weight, columns = weights[task.name], np.arange(nv)[task.columns]
            alone = diagonal[columns - base].copy()
            diagonal[columns - base] += weight
            # ½ w (x - b)² + ½ ε x² is ½ (w + ε) (x - t)² and a rest, with t = b w / (w + ε).
            share = weight / (weight + alone)
            entries.append((task, -share, share * alone, as_slice(columns)))
        inverse, minus_target = np.zeros(n + 1), np.zeros(n + 1)
        inverse[base:-1], minus_target[-1] = 1.0 / diagonal, 1.0
        cost = problem.cost if self._first else Quadratic(np.zeros((n, n)), np.zeros(n))
        names = tuple(task.name for task in taking_part + single)
        return _Plan(
            level=Level(names, cost, np.zeros((0, n)), np.zeros((0, n)), np.zeros(0), np.zeros(0)),
            kept=stack[:end, :n],
            scale=slack[:end, None] ** -0.5,
            squares=Squares(whole, slack, base, diagonal, inverse, minus_target),
            rows=rows,
            momentum=momentum,
            single=entries,
        )

    def _add_others(self, level: Level, layout: Layout, dynamics: Dynamics, references: References) -> None:
        """Add the tasks on forces and torques, and those with a tolerance."""
        nv, n = self._model.nv, layout.problem.n
        for task in self._others:
            weight = references.weights.get(task.name, 0.0)
            if weight <= 0.0:
                continue
            reference = references.tasks[task.name]
            if isinstance(task, AccelerationTask):
                J, right, self.errors[task.name] = task.equation(dynamics, reference)
                rows = np.hstack([J, np.zeros((len(J), n - nv))])
            elif isinstance(task, EffortTask) and (equation := task.equation(layout, reference)) is not None:
                rows, right = equation
            else:
                continue
            scale = weight**0.5
            level.tasks += (task.name,)
            rows, right = scale * rows, scale * right
            if task.tolerance is not None:
                band = scale * task.band()
                level.G = np.vstack([level.G, rows])
                level.lower = np.concatenate([level.lower, right - band])
                level.upper = np.concatenate([level.upper, right + band])
                continue
            level.add(rows, right, kept=not self._last)
