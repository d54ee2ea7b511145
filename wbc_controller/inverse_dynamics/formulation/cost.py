"""Cost of one priority level."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from wbc_controller.inverse_dynamics.arrays import consecutive
from wbc_controller.inverse_dynamics.formulation.layout import Layout
from wbc_controller.inverse_dynamics.formulation.plain_qp import ROTATION_LENGTH, Regularization, task_rows
from wbc_controller.inverse_dynamics.formulation.problem import FORCE_UNIT, Level, QuadraticCost
from wbc_controller.inverse_dynamics.formulation.problem_kernels import LeastSquares
from wbc_controller.inverse_dynamics.formulation.rows import CompiledRows, RowEntry
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.frame_kernels import JOINTS, MOMENTUM
from wbc_controller.inverse_dynamics.robot.instruction import Instruction
from wbc_controller.inverse_dynamics.tasks import EffortTask, MotionTask, PostureTask, Task
from wbc_controller.records import Array, References

Errors = tuple[Sequence[tuple[str, slice]], Array]  # name and part of each task of a level; the array


class LevelCost:
    """Cost of one priority level, for one set of active contacts and tasks.

        ½ Σ wᵢ ‖Rᵢ x - rᵢ‖² + ½ ε_a (‖q̈‖² + ‖ḣ_G / m‖²) + ½ ε_f fᵀ W f

    A posture task with weight w only adds to the diagonal of H, together with the regularization ε:

        ½ w (x - b)² + ½ ε x² = ½ (w + ε) (x - t)² + ½ b² ε w / (w + ε),    t = b w / (w + ε).

    A second posture task on the same joints adds likewise, with w + ε for ε and b - t for b. Posture tasks have rows
    only if a lower level must keep them.
    """

    def __init__(
        self, tasks: Sequence[Task], layout: Layout, dynamics: Dynamics, regularization: Regularization, *,
        first: bool, last: bool,
    ) -> None:  # fmt: skip
        problem, base = layout.problem, 6 if dynamics.model.floating_base else 0
        n = problem.n
        self._tasks, self._layout, self._dynamics, self._regularization = tasks, layout, dynamics, regularization
        instructions = {
            task.name: instruction
            for task in tasks
            if isinstance(task, MotionTask) and (instruction := task.instruction()) is not None
        }
        strict = [task for task in tasks if task.tolerance is None]
        posture = [task for task in strict if isinstance(task, PostureTask) and task.name in instructions]
        self._posture = posture if last else []
        with_rows = [task for task in strict if task not in self._posture]
        self._with_tolerance = [task for task in tasks if task.tolerance is not None]
        places = _places([*with_rows, *self._posture, *self._with_tolerance])
        self._errors_of, self._errors = list(places.items()), sum(task.dimension for task in tasks)
        self._rows_of = [(task.name, places[task.name]) for task in with_rows]
        end = sum(task.dimension for task in with_rows)
        count = end + base
        soft = len(layout.J) if first else 0
        top, bottom = problem.room - count, problem.room + len(problem.b)
        whole = problem.memory[top - soft : bottom] if first else np.zeros((count, n + 1))
        #: [R, r] of redundant contact directions, (nf, n + 1); first level only.
        self._redundant_rows, block = whole[:soft], whole[soft:]
        self._bands, bands = _places(self._with_tolerance), sum(task.dimension for task in self._with_tolerance)
        self._band_rows = np.zeros((bands, n + 1))
        self._band_scale, self._band_width = np.zeros(bands), np.zeros(bands)
        self._python_rows = [(task, self._band_rows[self._bands[task.name]]) for task in self._with_tolerance]

        entries = [RowEntry(instructions[task.name], 0, task, places[task.name].start) for task in self._posture]
        for task in with_rows:
            rows, instruction = places[task.name], instructions.get(task.name)
            if isinstance(task, MotionTask) and instruction is not None and instruction.kind != JOINTS:
                entries.append(RowEntry(instruction, rows.start, task, rows.start))
            else:
                self._python_rows.append((task, block[rows]))
        if base:
            entries.append(RowEntry(Instruction(MOMENTUM, np.arange(6)), end))
        if first:
            entries += [RowEntry(instruction, count + row) for instruction, row in layout.instructions]
        #: [R, r] and error slice of each effort task.
        self.effort_rows = [
            (rows, places[task.name]) for task, rows in self._python_rows if isinstance(task, EffortTask)
        ]
        weights = np.ones(soft + count)
        shared: dict[str, Any] = {"base": base, "diagonal": np.zeros(n), "target": np.zeros(n)}
        shared["constraints"] = problem.constraints
        self.squares = LeastSquares(rows=block[:count], weights=weights[soft:], **shared)  # weights w and ε
        self._with_redundant = LeastSquares(rows=whole[: soft + count], weights=weights, **shared)
        #: Compiled rows of tasks, and of contacts for the first level.
        self.rows = CompiledRows(dynamics, block, self.squares.target, entries)
        self._kept = [block[: 0 if last else end, :n], whole[: 0 if last else soft + end, :n]]
        self.level = Level(
            tasks=tuple(task.name for task in tasks),
            cost=problem.cost if first else QuadraticCost(np.zeros((n, n)), np.zeros(n)),
            kept=self._kept[0],
            G=np.zeros((bands, n)),
            lower=np.zeros(bands),
            upper=np.zeros(bands),
        )

    def set_parameters(self, weights: Mapping[str, float]) -> None:
        """Write weights of tasks and regularization, and gains."""
        squares, model = self.squares, self._dynamics.model
        epsilon_a, epsilon_f = self._regularization.acceleration, self._regularization.force
        for name, rows in self._rows_of:
            squares.weights[rows] = weights[name]
        if squares.base:
            squares.weights[-6:] = epsilon_a * (np.repeat([1.0, 1.0 / ROTATION_LENGTH], 3) / model.mass) ** 2
        squares.diagonal[squares.base : model.nv] = epsilon_a
        squares.diagonal[model.nv :] = epsilon_f * FORCE_UNIT**2 * self._layout.metric
        for task in self._posture:
            w, epsilon = weights[task.name], squares.diagonal[task.columns]
            self.rows.factors[task.name][:] = w / (w + epsilon), epsilon * w / (w + epsilon)
            squares.diagonal[task.columns] += w
        for soft in self._with_tolerance:
            band, scale = self._bands[soft.name], weights[soft.name] ** 0.5
            self._band_scale[band] = scale
            self._band_width[band] = scale * soft.band()
        self.rows.set_gains()

    def set_references(self, references: References) -> Array:
        """Copy references of compiled rows; return an array for the errors of all tasks."""
        self.rows.set_references(references.tasks)
        return np.empty(self._errors)

    def complete(self, references: References, constant: float, errors: Array) -> Errors:
        """Fill the rows and errors that are evaluated in Python, and update the level."""
        level, places = self.level, self._errors_of
        level.cost.update(self.squares, constant)
        level.kept = self._kept[0]
        if not self._python_rows:
            return places, errors
        missing, place_of = set(), dict(places)
        for task, rows in self._python_rows:
            found = task_rows(task, self._dynamics, self._layout, references.tasks[task.name], rows.shape[1] - 1)
            if found is None:
                missing.add(task.name)
                rows[:] = 0.0
            else:
                rows[:, :-1], rows[:, -1], errors[place_of[task.name]] = found
        if self._with_tolerance:
            scaled = self._band_scale[:, None] * self._band_rows
            level.G[:], middle = scaled[:, :-1], scaled[:, -1]
            level.lower[:], level.upper[:] = middle - self._band_width, middle + self._band_width
        level.tasks = tuple(task.name for task in self._tasks if task.name not in missing)
        return [(name, place) for name, place in places if name not in missing], errors

    def add_redundant_rows(self, rows: Array) -> None:
        """Add rows [R, r] of redundant contact directions, (nf, nv + 1), to the cost of this cycle."""
        cost, nv = self.level.cost, self._dynamics.model.nv
        self._redundant_rows[:, :nv], self._redundant_rows[:, -1] = rows[:, :-1], rows[:, -1]
        cost.update(self._with_redundant, cost.squares_constant)
        self.level.kept = self._kept[1]


def _places(tasks: Sequence[Task]) -> dict[str, slice]:
    return {task.name: rows for task, rows in zip(tasks, consecutive(task.dimension for task in tasks), strict=True)}
