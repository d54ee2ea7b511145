"""The cost of one priority: the weighted rows of its tasks, and the regularization."""

from __future__ import annotations

from collections.abc import Sequence

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
        self._diagonals: dict[int, tuple[list[float], Array, Array]] = {}
        self._none: dict[int, Array] = {}

    def fill(self, layout: Layout, cost: Quadratic, dynamics: Dynamics, references: References) -> Level:
        """Write the cost of one cycle.

        Args:
            layout: with the equations of motion filled.
            cost: to be overwritten.
            dynamics: the snapshot.
            references: what is wanted, and how much.
        """
        nv, g, weights = self._model.nv, cost.g, references.weights
        n = len(g)
        errors = self.errors = {}
        taking_part: list[str] = []
        stack = layout.problem.stack if self._first else None
        stack = np.zeros((self.rows, n)) if stack is None else stack
        top = len(stack) - self.rows
        rows, minus_right = stack[top:, :nv], np.empty(self.rows)
        row = 0
        for task in self._exact:
            name = task.name
            weight = weights.get(name, 0.0)
            if not weight <= 0.0:  # NaN goes on, to be found
                J, right, errors[name] = task.equation(dynamics, references.tasks[name])
                end = row + len(right)
                scale = weight**0.5
                np.multiply(J, scale, out=rows[row:end])
                np.multiply(right, -scale, out=minus_right[row:end])
                taking_part.append(name)
                row = end
        of_tasks = row
        if self._base:  # √ε_a ḣ_G / m, for a base that moves
            row += 6
            np.multiply(dynamics.centroidal_matrix, self._momentum_scale_rows, out=rows[of_tasks:row])
            np.multiply(dynamics.centroidal_drift, self._momentum_scale, out=minus_right[of_tasks:row])
        rows, minus_right = stack[top : top + row], minus_right[:row]
        minus_right.dot(rows, out=g)
        constant = 0.5 * float(minus_right.dot(minus_right))
        single = [0.0 if (weight := weights.get(task.name, 0.0)) <= 0.0 else weight for task in self._single]
        for task, weight in zip(self._single, single, strict=True):
            if weight != 0.0:
                right, errors[task.name] = task.right(dynamics, references.tasks[task.name])
                g[task.columns] -= weight * right
                constant += 0.5 * weight * float(right.dot(right))
                taking_part.append(task.name)
        cost.squares = Squares(stack[: top + row], rows, self._base, *self._diagonal(n, single))
        if n not in self._none:
            self._none[n] = np.zeros((0, n))
        none = self._none[n]
        level = Level(tuple(taking_part), cost, constant, none, none, _NONE, _NONE)
        if not self._last:
            level.kept = rows[:of_tasks].copy()
        if self._others:
            self._add_others(level, layout, dynamics, references)
        return level

    def _diagonal(self, n: int, weights: list[float]) -> tuple[Array, Array]:
        """Diagonal of H without the rows, (n,), and its inverse but for the base's columns, where both are 0."""
        if n not in self._diagonals or self._diagonals[n][0] != weights:
            nv = self._model.nv
            diagonal, inverse = np.zeros(n), np.zeros(n)
            diagonal[self._base : nv], diagonal[nv:] = self._regularization
            for task, weight in zip(self._single, weights, strict=True):
                diagonal[task.columns] += weight
            inverse[self._base :] = 1.0 / diagonal[self._base :]
            self._diagonals[n] = (weights, diagonal, inverse)
        return self._diagonals[n][1:]

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
