"""The cost of one priority: the weighted rows of its tasks, and the regularization."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from wbc_controller.core.dynamics import Dynamics
from wbc_controller.core.model import RobotModel
from wbc_controller.core.problem import FORCE_UNIT, Layout, Level
from wbc_controller.core.tasks import AccelerationTask, EffortTask, Task
from wbc_controller.records import Array, References

#: Length that makes a rate of angular momentum comparable to one of linear momentum in the regularization, m.
ROTATION_LENGTH = 0.1

_NONE = np.zeros(0)


class LevelCost:
    """Fills one `Level`: ½ Σ wᵢ ‖Rᵢ x - rᵢ‖² + ½ ε_a (‖q̈‖² + ‖ḣ_G / m‖²) + ½ ε_f ‖f‖².

    Attributes:
        level: the priority.
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
        self._diagonal = np.zeros(model.nv)
        self._diagonal[6 if model.floating_base else 0 :] = regularization_acceleration
        self._regularization_force = regularization_force * FORCE_UNIT**2
        scale = np.repeat([1.0, 1.0 / ROTATION_LENGTH], 3) * (regularization_acceleration**0.5 / model.mass)
        self._momentum_scale = scale[:, None]
        self._momentum_scale_right = -scale
        rows = sum(task.dimension for task in self._exact) + 6
        self._rows = np.zeros((rows, model.nv))
        self._right = np.zeros(rows)
        self._none: dict[int, Array] = {}

    def fill(self, layout: Layout, H: Array, g: Array, dynamics: Dynamics, references: References) -> Level:
        """Write the cost of one cycle.

        Args:
            layout: with the equations of motion filled.
            H: (n, n), to be overwritten.
            g: (n,), to be overwritten.
            dynamics: the snapshot.
            references: what is wanted, and how much.
        """
        nv, n = self._model.nv, len(g)
        self.errors = {}
        taking_part: list[str] = []
        row = 0
        for task in self._exact:
            weight = references.weights.get(task.name, 0.0)
            if weight <= 0.0:
                continue
            J, right, self.errors[task.name] = task.equation(dynamics, references.tasks[task.name])
            end = row + len(right)
            scale = weight**0.5
            np.multiply(J, scale, out=self._rows[row:end])
            np.multiply(right, scale, out=self._right[row:end])
            taking_part.append(task.name)
            row = end
        of_tasks = row
        row = self._regularize_momentum(dynamics, row)
        rows, right = self._rows[:row], self._right[:row]
        H[:nv, :nv] = rows.T @ rows
        g[:nv] = -right @ rows
        constant = 0.5 * float(right @ right)
        diagonal = H.reshape(-1)[:: n + 1]
        diagonal[:nv] += self._diagonal
        diagonal[nv:] = self._regularization_force
        for task in self._single:
            weight = references.weights.get(task.name, 0.0)
            if weight <= 0.0:
                continue
            right, self.errors[task.name] = task.right(dynamics, references.tasks[task.name])
            diagonal[task.columns] += weight
            g[task.columns] -= weight * right
            constant += 0.5 * weight * float(right @ right)
            taking_part.append(task.name)
        if n not in self._none:
            self._none[n] = np.zeros((0, n))
        none = self._none[n]
        level = Level(tuple(taking_part), H, g, constant, none, none, _NONE, _NONE)
        if not self._last:
            level.kept = np.zeros((of_tasks, n))
            level.kept[:, :nv] = rows[:of_tasks]
        if self._others:
            self._add_others(level, layout, dynamics, references)
        return level

    def _regularize_momentum(self, dynamics: Dynamics, row: int) -> int:
        """Add the rows of √ε_a ḣ_G / m, for a base that moves; gives the number of rows filled."""
        if not self._model.floating_base:
            return row
        np.multiply(dynamics.centroidal_matrix, self._momentum_scale, out=self._rows[row : row + 6])
        np.multiply(dynamics.centroidal_drift, self._momentum_scale_right, out=self._right[row : row + 6])
        return row + 6

    def _add_others(self, level: Level, layout: Layout, dynamics: Dynamics, references: References) -> None:
        """Add the tasks on forces and torques, and those with a tolerance."""
        nv, n = self._model.nv, len(level.g)
        level.H[:nv, nv:] = level.H[nv:, :nv] = 0.0
        level.H[nv:, nv:] = np.diag(np.diagonal(level.H)[nv:])
        level.g[nv:] = 0.0
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
            level.H += rows.T @ rows
            level.g -= rows.T @ right
            level.constant += 0.5 * float(right @ right)
            if not self._last:
                level.kept = np.vstack([level.kept, rows])
