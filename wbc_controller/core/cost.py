"""The cost of one priority: the weighted rows of its tasks, and the regularization."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from wbc_controller.core.dynamics import Dynamics
from wbc_controller.core.model import RobotModel
from wbc_controller.core.problem import FORCE_UNIT, Layout, Level, Quadratic, Squares
from wbc_controller.core.tasks import AccelerationTask, EffortTask, Task
from wbc_controller.records import Array, References

#: Length that makes a rate of angular momentum comparable to one of linear momentum in the regularization, m.
ROTATION_LENGTH = 0.1

_NONE = np.zeros(0)


class LevelCost:
    """Fills one `Level`: ½ Σ wᵢ ‖Rᵢ x - rᵢ‖² + ½ ε_a (‖q̈‖² + ‖ḣ_G / m‖²) + ½ ε_f ‖f‖².

    Attributes:
        level: the priority.
        rows: largest number of rows that it fills.
        errors: norm of the error of each acceleration task that took part in the last cycle.
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
        self.errors: dict[str, float] = {}
        exact = [task for task in own if isinstance(task, AccelerationTask) and task.tolerance is None]
        # Rows that are single accelerations enter the diagonal alone, unless a level below has to keep them as rows.
        self._single = [task for task in exact if task.columns is not None and last]
        self._exact = [task for task in exact if task not in self._single]
        self._others = [task for task in own if task not in exact]
        self._model = model
        self._last = last
        self._base = 6 if model.floating_base else 0
        self._regularization = (regularization_acceleration, regularization_force * FORCE_UNIT**2)
        scale = np.repeat([1.0, 1.0 / ROTATION_LENGTH], 3) * (regularization_acceleration**0.5 / model.mass)
        self._momentum_scale, self._momentum_scale_rows = scale, scale[:, None]
        self._first = level == min(task.level for task in tasks)
        self.rows = sum(task.dimension for task in self._exact) + 6
        self._weights: list[float] = []
        self._weighted_rows: list[tuple[AccelerationTask, Array, Array]] = []
        self._weighted_single: list[tuple[AccelerationTask, Array]] = []
        self._taking_part: tuple[str, ...] = ()
        self._diagonals: dict[int, tuple[Array, Array]] = {}
        self._none: dict[int, Array] = {}

    def fill(self, layout: Layout, cost: Quadratic, dynamics: Dynamics, references: References) -> Level:
        """Write the cost of one cycle.

        Args:
            layout: with the equations of motion filled.
            cost: to be overwritten.
            dynamics: the snapshot.
            references: what is wanted, and how much.
        """
        nv, g, wanted = self._model.nv, cost.g, references.tasks
        n = len(g)
        self._weigh(references.weights)
        errors = self.errors = {}
        stack = layout.problem.stack if self._first else None
        stack = np.zeros((self.rows, n)) if stack is None else stack
        top = len(stack) - self.rows
        rows, minus_right = stack[top:, :nv], np.empty(self.rows)
        row = 0
        for task, scale, minus_scale in self._weighted_rows:
            J, right, errors[task.name] = task.equation(dynamics, wanted[task.name])
            end = row + len(right)
            np.multiply(J, scale, out=rows[row:end])
            np.multiply(right, minus_scale, out=minus_right[row:end])
            row = end
        of_tasks = row
        if self._base:  # √ε_a ḣ_G / m, for a base that moves
            row += 6
            np.multiply(dynamics.centroidal_matrix, self._momentum_scale_rows, out=rows[of_tasks:row])
            np.multiply(dynamics.centroidal_drift, self._momentum_scale, out=minus_right[of_tasks:row])
        rows, minus_right = stack[top : top + row], minus_right[:row]
        minus_right.dot(rows, out=g)
        constant = 0.5 * float(minus_right.dot(minus_right))
        for task, weight in self._weighted_single:
            right, errors[task.name] = task.right(dynamics, wanted[task.name])
            weighted = weight * right
            g[task.columns] -= weighted
            constant += 0.5 * float(weighted.dot(right))
        cost.squares = Squares(stack[: top + row], rows, self._base, *self._diagonal(n))
        if n not in self._none:
            self._none[n] = np.zeros((0, n))
        none = self._none[n]
        level = Level(self._taking_part, cost, constant, none, none, _NONE, _NONE)
        if not self._last:
            level.kept = rows[:of_tasks].copy()
        if self._others:
            self._add_others(level, layout, dynamics, references)
        return level

    def _weigh(self, weights: Mapping[str, float]) -> None:
        """Find which tasks take part, where a weight has changed. What NaN weighs does: it is found later."""
        present = [weights.get(task.name, 0.0) for task in (*self._exact, *self._single)]
        if present == self._weights:
            return
        self._weights = present
        taking_part = {task.name for task in (*self._exact, *self._single) if not weights.get(task.name, 0.0) <= 0.0}
        roots = {name: np.array(weights[name] ** 0.5) for name in taking_part}  # as arrays they multiply faster
        self._weighted_rows = [(t, roots[t.name], -roots[t.name]) for t in self._exact if t.name in taking_part]
        self._weighted_single = [(t, np.array(weights[t.name])) for t in self._single if t.name in taking_part]
        self._taking_part = tuple(t.name for t in (*self._exact, *self._single) if t.name in taking_part)
        self._diagonals.clear()

    def _diagonal(self, n: int) -> tuple[Array, Array]:
        """Diagonal of H without the rows, (n,), and its inverse but for the base's columns, where both are 0."""
        if n not in self._diagonals:
            nv = self._model.nv
            diagonal, inverse = np.zeros(n), np.zeros(n)
            diagonal[self._base : nv], diagonal[nv:] = self._regularization
            for task, weight in self._weighted_single:
                diagonal[task.columns] += weight
            inverse[self._base :] = 1.0 / diagonal[self._base :]
            self._diagonals[n] = (diagonal, inverse)
        return self._diagonals[n]

    def _add_others(self, level: Level, layout: Layout, dynamics: Dynamics, references: References) -> None:
        """Add the tasks on forces and torques, and those with a tolerance."""
        nv, n = self._model.nv, len(level.g)
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
