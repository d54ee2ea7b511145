"""The rows of contacts and tasks that compiled code fills in one call, and what it follows from cycle to cycle."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from wbc_controller.compiled import Bound
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.frame_kernels import JOINTS, MOMENTUM, take_reference
from wbc_controller.inverse_dynamics.robot.instruction import Instruction
from wbc_controller.inverse_dynamics.tasks.task import MotionTask
from wbc_controller.records import Array, Reference


class _Followed:
    """A task whose gains and reference are copied where compiled code reads them, when they change."""

    __slots__ = ("_gains", "_newest", "_size", "_task", "_wanted", "name", "reference", "shares")

    def __init__(self, task: MotionTask, numbers: Array) -> None:
        """Take views of the numbers after the task's constants."""
        self.name, self._task = task.name, task
        self.reference: Reference | None = None  # that need not be copied again
        self._newest: Reference | None = None
        self._size = size = task.size
        gains, self._wanted, self.shares = np.split(numbers, np.cumsum([2 * size, task.form.size + 2 * size]))
        self._gains = gains.reshape(2, size)

    def follow(self, reference: Reference) -> None:
        """Take over a reference.

        Raises:
            ValueError: where one of its arrays has another size.
            TypeError: where one of them is no array of float64 with one axis.
        """
        arrays = position, velocity, acceleration = reference.position, reference.velocity, reference.acceleration
        if not take_reference(position, velocity, acceleration, self._size, self._wanted):
            raise ValueError(
                f"the reference of task {self.name!r} has {len(position)} positions, {len(velocity)} velocities and "
                f"{len(acceleration)} accelerations; expected {self._task.form.size}, {self._size} and {self._size}"
            )
        again, self._newest = reference is self._newest, reference
        # One that moves is not asked; one that can be written may be another one in the next cycle.
        self.reference = reference if again and not any(array.flags.writeable for array in arrays) else None

    def tune(self) -> None:
        """Take over the gains."""
        self._gains[0], self._gains[1] = self._task.stiffness, self._task.damping


class Rows:
    """Instructions for the rows of some contacts and tasks in one block of rows, [J, b].

    Attributes:
        places: name of each task, and where its error is among all of them.
        bound: the instructions and arrays for `robot.frame_kernels.fill_rows`.
        shares: of each task on single accelerations, by name, two factors for each (`robot.frame_kernels`), (2 size,).
    """

    def __init__(
        self,
        dynamics: Dynamics,
        out: Array,
        minus_target: Array,
        contacts: Iterable[tuple[Instruction, int]] = (),
        tasks: Iterable[tuple[MotionTask, Instruction, int]] = (),
        momentum: int | None = None,
    ) -> None:
        """Lay out the instructions.

        Args:
            dynamics: the snapshot, whose arrays the rows are made of.
            out: the block, (k, n + 1).
            minus_target: for the negative targets of single accelerations, (n + 1,).
            contacts: their instructions, each with its first row in the block.
            tasks: likewise; a task on single accelerations has no row.
            momentum: first row of the rate of the momentum; None where the block has none.
        """
        self.places: list[tuple[str, slice]] = []
        self.shares: dict[str, Array] = {}
        steps: list[tuple[int, ...]] = []
        places: list[np.ndarray] = []
        numbers: list[Array] = []
        at = [0, 0, 0]  # in places, numbers and errors

        def add(step: Instruction, row: int, more: int, errors: int) -> None:
            steps.append(
                (step.kind, row, 0 if step.kind == JOINTS else len(step.rows), step.link, step.other, step.first)
                + (step.size, *at)
            )
            places.append(step.rows)
            numbers.append(np.concatenate([step.constants, np.zeros(more)]))
            at[0] += len(step.rows)
            at[1] += len(numbers[-1])
            at[2] += errors

        for step, row in contacts:
            add(step, row, 0, 0)
        own: list[tuple[MotionTask, Instruction, slice]] = []
        for task, step, row in tasks:
            begin = at[1] + len(step.constants)
            self.places.append((task.name, slice(at[2], at[2] + task.dimension)))
            factors = 2 * task.size if step.kind == JOINTS else 0
            add(step, row, 4 * task.size + task.form.size + factors, task.dimension)
            own.append((task, step, slice(begin, at[1])))
        if momentum is not None:
            add(Instruction(MOMENTUM, np.arange(6)), momentum, 0, 0)
        self._errors = at[2]
        values = np.concatenate([np.zeros(0), *numbers])
        self._followed: list[_Followed] = []
        for task, step, place in own:
            followed = _Followed(task, values[place])
            self._followed.append(followed)
            if step.kind == JOINTS:
                self.shares[task.name] = followed.shares
        told = (
            np.array(steps, dtype=np.int64).reshape(-1, 10),
            np.concatenate([np.zeros(0, dtype=np.int64), *places]).astype(np.int64),
            values,
        )
        sizes = *map(len, told), len(dynamics.links), *out.shape
        self.bound = Bound(*sizes, *told, *dynamics.terms, out, minus_target)

    def follow(self, wanted: Mapping[str, Reference]) -> Array:
        """Take over references; gives the memory for the errors of all tasks, one after the other.

        Args:
            wanted: the references by task.
        """
        for followed in self._followed:
            reference = wanted[followed.name]
            if reference is not followed.reference:
                followed.follow(reference)
        return np.empty(self._errors)

    def tune(self) -> None:
        """Take over the gains of the tasks."""
        for followed in self._followed:
            followed.tune()
