"""The cost of one priority level: the weighted rows of its tasks, and the regularization."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from wbc_controller.errors import MethodError
from wbc_controller.inverse_dynamics.arrays import as_slice
from wbc_controller.inverse_dynamics.formulation.layout import FORCE_UNIT, Layout
from wbc_controller.inverse_dynamics.formulation.problem import Level, Quadratic, Squares
from wbc_controller.inverse_dynamics.formulation.rows import Rows
from wbc_controller.inverse_dynamics.method_calls import arrays_of, checked, is_finite, raised
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.frame_kernels import JOINTS
from wbc_controller.inverse_dynamics.robot.instruction import Instruction
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.tasks import AccelerationTask, EffortTask, Task
from wbc_controller.inverse_dynamics.tasks.task import MotionTask, equation_of, evaluate
from wbc_controller.records import Array, Reference, References

#: Length that scales rates of angular momentum to those of linear momentum in the regularization, m.
ROTATION_LENGTH = 0.1


#: Task errors of one level, which later cycles do not change: name of each task whose error is in an array, and where;
#: the array; and the errors of other tasks.
Errors = tuple[Sequence[tuple[str, slice]], Array, dict[str, Array]]


@dataclass(slots=True)
class _Plan:
    """The arrays of a level's cost, for one set of active contacts and one set of tasks with non-zero weight.

    Attributes:
        level: the level, whose cost is set in every cycle.
        squares: the squares that make up the cost.
        rows: what compiled code fills.
        counts: each task with rows, and their number.
        others: each task with rows that it fills itself, and views for its J and its right-hand side.
        compiled: whether compiled code fills all rows and targets.
        metric: diagonal of W in the regularization of the forces, (nf,).
        single: each task on single components of v̇, and the indices of these components.
        minus_shares: for each task in `single`, the negative factor from its right-hand side to the target.
        rests: for each task in `single`, the factor from its squared right-hand side to twice the constant.
        weights: the weights for which slack, diagonal, shares and rests were computed.
    """

    level: Level
    squares: Squares
    rows: Rows
    counts: list[tuple[str, int]]
    others: list[tuple[AccelerationTask, Array, Array]]
    compiled: bool
    metric: Array
    single: list[tuple[AccelerationTask, np.ndarray | slice]]
    minus_shares: list[Array] = field(default_factory=list)
    rests: list[Array] = field(default_factory=list)
    weights: Mapping[str, float] = field(default_factory=dict)


def _is_finite(reference: Reference) -> bool:
    return all(is_finite(part) for part in (reference.position, reference.velocity, reference.acceleration))


def _right_of(task: AccelerationTask, dynamics: Dynamics, reference: Reference) -> tuple[Array, Array]:
    """`AccelerationTask.right`, checked; a task that fails is evaluated again, so that the error names the method."""
    size = (task.size,)
    try:
        right, error = arrays_of(task, "right", task.right(dynamics, reference), (size, size))
    except Exception as failure:
        evaluate(task, dynamics, reference)
        raise failure if isinstance(failure, MethodError) else raised(task, "right", failure) from failure
    if not is_finite(right) and _is_finite(reference):
        evaluate(task, dynamics, reference)
    return right, error


def _equation_of(task: AccelerationTask, dynamics: Dynamics, reference: Reference) -> tuple[Array, Array, Array]:
    """`AccelerationTask.equation`, checked like `_right_of`."""
    k = (task.dimension,)
    try:
        equation = task.equation(dynamics, reference)
        J, right, error = arrays_of(task, "equation", equation, ((*k, dynamics.model.nv), k, k))
    except Exception as failure:
        evaluate(task, dynamics, reference)
        raise failure if isinstance(failure, MethodError) else raised(task, "equation", failure) from failure
    if not (is_finite(J) and is_finite(right)) and _is_finite(reference):
        evaluate(task, dynamics, reference)
    return J, right, error


class LevelCost:
    """Fills one `Level`: ½ Σ wᵢ ‖Rᵢ x - rᵢ‖² + ½ ε_a (‖q̈‖² + ‖ḣ_G / m‖²) + ½ ε_f fᵀ W f.

    Attributes:
        level: the priority level.
        rows: largest number of rows of the cost.
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
            level: the priority level.
            tasks: all tasks of the controller; those of this level are used.
            model: the robot's model.
            last: whether this is the lowest level, so that no rows have to be kept for levels below.
            regularization_acceleration: ε_a.
            regularization_force: ε_f.
        """
        own = [task for task in tasks if task.level == level]
        self.level = level
        exact = [task for task in own if isinstance(task, AccelerationTask) and task.tolerance is None]
        # Tasks on single components of v̇ only add to the diagonal of H, unless a lower level needs them as rows, or
        # another task already uses the same components.
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
        self._taking_part: tuple[str, ...] = ()
        self._plans: dict[tuple[tuple[str, ...], tuple[str, ...]], _Plan] = {}
        self._current: _Plan  # of the last cycle

    def prepare(self, layout: Layout, dynamics: Dynamics, weights: Mapping[str, float]) -> Rows:
        """Take over weights and gains.

        Args:
            layout: of the active contacts.
            dynamics: the snapshot.
            weights: of the tasks.

        Returns:
            How compiled code fills the rows of the tasks on accelerations and, on the first level, those of contacts.
        """
        if weights != self._weights:
            self._weights = dict(weights)
            # Tasks with a NaN weight take part, so that the check for finite values finds it later.
            self._taking_part = tuple(
                task.name for task in (*self._exact, *self._single) if not weights.get(task.name, 0.0) <= 0.0
            )
        key = (layout.key, self._taking_part)
        if key not in self._plans:
            self._plans[key] = self._plan(layout, dynamics)
        plan = self._current = self._plans[key]
        if plan.weights is not self._weights:
            self._weigh(plan)
        plan.rows.tune()
        return plan.rows

    @property
    def compiled(self) -> bool:
        """Whether compiled code fills all of the level."""
        return self._last and not self._others and self._current.compiled

    @property
    def rows_of(self) -> Rows:
        """How compiled code fills the rows of the last `prepare`."""
        return self._current.rows

    @property
    def posed(self) -> Level:
        """The level of the last `prepare`, without tasks on forces and torques and those with a tolerance."""
        return self._current.level

    def pose(self) -> Squares:
        """Make the cost of the level the sum of its squares, and give them."""
        self._current.level.cost.pose(self._current.squares)
        return self._current.squares

    def complete(self, dynamics: Dynamics, references: References, rest: float, errors: Array) -> Errors:
        """Fill the rows and targets that compiled code does not know, and pose the cost.

        Args:
            dynamics: the snapshot.
            references: task references and weights.
            rest: what the compiled code has returned.
            errors: and what it has found of the tasks.
        """
        plan, wanted, squares = self._current, references.tasks, self.pose()
        squares.constant = rest
        others: dict[str, Array] = {}
        for task, rows, right in plan.others:
            reference = wanted[task.name]
            try:
                others[task.name] = checked(task, "fill", task.fill(dynamics, reference, rows, right), right.shape)
            except Exception as error:
                evaluate(task, dynamics, reference)  # names the method, if it fails by itself
                raise error if isinstance(error, MethodError) else raised(task, "fill", error) from error
            if not (is_finite(rows) and is_finite(right)) and _is_finite(reference):
                evaluate(task, dynamics, reference)
        for (task, columns), minus_share, share in zip(plan.single, plan.minus_shares, plan.rests, strict=True):
            if task.name not in plan.rows.shares:
                asked, others[task.name] = _right_of(task, dynamics, wanted[task.name])
                squares.minus_target[columns] = minus_share * asked
                squares.constant += 0.5 * float((share * asked).dot(asked))
        return plan.rows.places, errors, others

    def level_of(self, layout: Layout, dynamics: Dynamics, references: References, errors: Errors) -> Level:
        """The level of one cycle, with the tasks on forces and torques and those with a tolerance.

        Args:
            layout: with the equations of motion filled, whose rows are complete.
            dynamics: the snapshot.
            references: task references and weights.
            errors: for those of the tasks with a tolerance.
        """
        plan = self._current
        if not self._others:
            return plan.level  # only its cost and the values of its rows change from cycle to cycle
        level = replace(plan.level)
        self._add_others(level, layout, dynamics, references, errors[2])
        return level

    def _plan(self, layout: Layout, dynamics: Dynamics) -> _Plan:
        """Lay out the rows of the tasks with non-zero weight."""
        problem, nv, n, base = layout.problem, self._model.nv, layout.problem.n, self._base
        with_rows = [task for task in self._exact if task.name in self._taking_part]
        single = [task for task in self._single if task.name in self._taking_part]
        end = sum(task.dimension for task in with_rows)
        count = end + base
        # The rows of the first level are stored directly above the equalities: the solver uses both as one block.
        top, stop = problem.room - count, problem.room + len(problem.b)
        stack = problem.memory[top:stop] if self._first else np.zeros((count, n + 1))
        compiled: list[tuple[MotionTask, Instruction, int]] = []
        others, counts, start = [], [], 0
        for task in with_rows:
            instruction = task.instruction()
            if isinstance(task, MotionTask) and instruction is not None and instruction.kind != JOINTS:
                compiled.append((task, instruction, start))
            else:
                stop = start + task.dimension
                others.append((task, stack[start:stop, :nv], stack[start:stop, n]))
            counts.append((task.name, task.dimension))
            start += task.dimension
        for task in single:
            instruction = task.instruction()
            if isinstance(task, MotionTask) and instruction is not None:
                compiled.append((task, instruction, 0))
        contacts = layout.instructions if self._first else ()
        minus_target = np.zeros(n + 1)
        minus_target[-1] = 1.0
        cost = problem.cost if self._first else Quadratic(np.zeros((n, n)), np.zeros(n))
        rows = Rows(
            dynamics,
            stack,
            minus_target,
            [(instruction, count + row) for instruction, row in contacts],
            compiled,
            end if base else None,
        )
        kept = stack[: 0 if self._last else end, :n]
        return _Plan(
            level=Level(self._taking_part, cost, kept, np.zeros((0, n)), np.zeros(0), np.zeros(0)),
            squares=Squares(stack, np.empty(count), base, np.empty(n - base), np.zeros(n + 1), minus_target),
            rows=rows,
            counts=counts,
            others=others,
            compiled=not others and all(task.name in rows.shares for task in single),
            metric=layout.metric,
            single=[(task, as_slice(np.arange(nv)[task.columns])) for task in single],
        )

    def _weigh(self, plan: _Plan) -> None:
        """Recompute all that depends on the weights."""
        weights, squares, base = self._weights, plan.squares, self._base
        plan.weights = weights
        end = 0
        for name, rows in plan.counts:
            start, end = end, end + rows
            squares.slack[start:end] = 1.0 / weights[name]
        squares.slack[end:] = self._momentum_slack[: len(squares.slack) - end]
        nj = self._model.nv - base
        accelerations, forces = self._regularization
        squares.diagonal[:nj], squares.diagonal[nj:] = accelerations, forces * plan.metric
        plan.minus_shares, plan.rests = [], []
        for task, columns in plan.single:
            # With the task's weight w and the regularization ε, ½ w (x - b)² + ½ ε x² = ½ (w + ε) (x - t)² + a constant
            # ½ b² ε w / (w + ε), where t = b w / (w + ε).
            weight, places = weights[task.name], as_slice(np.arange(self._model.nv)[columns] - base)
            there = np.array(squares.diagonal[places])
            plan.minus_shares.append(-weight / (weight + there))
            plan.rests.append(weight * there / (weight + there))
            squares.diagonal[places] += weight
            if task.name in plan.rows.shares:
                plan.rows.shares[task.name][:] = np.concatenate([plan.minus_shares[-1], plan.rests[-1]])
        # A new array, so that a solver can tell by its identity that the weights have changed.
        squares.inverse = np.zeros(len(squares.inverse))
        squares.inverse[base:-1] = 1.0 / squares.diagonal

    def _add_others(
        self,
        level: Level,
        layout: Layout,
        dynamics: Dynamics,
        references: References,
        errors: dict[str, Array],
    ) -> None:
        """Add the tasks on forces and torques, and the tasks with a tolerance."""
        nv, n = self._model.nv, layout.problem.n
        for task in self._others:
            weight = references.weights.get(task.name, 0.0)
            if weight <= 0.0:
                continue
            reference = references.tasks[task.name]
            if isinstance(task, AccelerationTask):
                J, right, errors[task.name] = _equation_of(task, dynamics, reference)
                rows = np.hstack([J, np.zeros((len(J), n - nv))])
            elif isinstance(task, EffortTask) and (equation := equation_of(task, layout, reference, n)) is not None:
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
