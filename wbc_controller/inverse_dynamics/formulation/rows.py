"""Compiled rows of contacts and tasks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.frame_kernels import JOINTS, FrameRows
from wbc_controller.inverse_dynamics.robot.instruction import Instruction
from wbc_controller.inverse_dynamics.tasks.task import MotionTask
from wbc_controller.records import Array, Reference


@dataclass(frozen=True, slots=True)
class RowEntry:
    """Rows of one contact or task, or of the momentum."""

    instruction: Instruction
    row: int = 0  # first row in the block; 0 for joint tasks
    task: MotionTask | None = None  # None for contacts and the momentum
    error: int = 0  # first index of the error


@dataclass(slots=True)
class _TaskNumbers:
    task: MotionTask
    gains: Array  # K and D, (2, size)
    position: Array  # of the reference
    motion: Array  # its velocity and acceleration, (2, size)
    copied: Reference | None = None  # last read-only reference


class CompiledRows:
    """Rows [J, b] of contacts and tasks in one block, filled by `robot.frame_kernels.fill_rows` from `arrays`."""

    def __init__(self, dynamics: Dynamics, out: Array, target: Array, entries: Sequence[RowEntry]) -> None:
        instructions: list[tuple[int, ...]] = []
        places: list[np.ndarray] = [np.zeros(0, dtype=np.int64)]
        numbers: list[Array] = [np.zeros(0)]
        for entry in entries:
            step, task, joints = entry.instruction, entry.task, entry.instruction.kind == JOINTS
            begin = step.kind, entry.row, 0 if joints else len(step.rows), step.link, step.other, step.first, step.size
            instructions.append((*begin, sum(map(len, places)), sum(map(len, numbers)), entry.error))
            own = 0 if task is None else 4 * task.size + task.form.size + (2 * step.size if joints else 0)
            places.append(step.rows)
            numbers += [step.constants, np.zeros(own)]
        self.arrays = FrameRows(
            instructions=np.array(instructions, dtype=np.int64).reshape(-1, 10),
            places=np.concatenate(places).astype(np.int64),
            numbers=np.concatenate(numbers),
            motion=dynamics.motion,
            out=out,
            target=target,
        )
        self.factors: dict[str, Array] = {}  # of joint tasks, (2, size), the last `numbers` of `_joint_targets`
        self._tasks: list[_TaskNumbers] = []
        for entry, step_numbers in zip(entries, self.arrays.instructions[:, 8].tolist(), strict=True):
            task = entry.task
            if task is None:
                continue
            values = self.arrays.numbers[step_numbers + len(entry.instruction.constants) :]
            ends = np.cumsum([2 * task.size, task.form.size, 2 * task.size, 2 * task.size])
            gains, position, motion, shares, _ = np.split(values, ends)
            self._tasks.append(_TaskNumbers(task, gains.reshape(2, -1), position, motion.reshape(2, -1)))
            if entry.instruction.kind == JOINTS:
                self.factors[task.name] = shares.reshape(2, -1)

    def set_gains(self) -> None:
        """Copy the gains of the tasks."""
        for own in self._tasks:
            own.gains[0], own.gains[1] = own.task.stiffness, own.task.damping

    def set_references(self, references: Mapping[str, Reference]) -> None:
        """Copy the references of the tasks; raises ValueError for an array of wrong size."""
        for own in self._tasks:
            task, wanted = own.task, references[own.task.name]
            if wanted is own.copied:
                continue
            position, velocity, acceleration = wanted.position, wanted.velocity, wanted.acceleration
            if not (len(position) == len(own.position) and len(velocity) == len(acceleration) == task.size):
                raise ValueError(
                    f"the reference of task {task.name!r} has {len(position)} positions, {len(velocity)} velocities "
                    f"and {len(acceleration)} accelerations; expected {task.form.size}, {task.size} and {task.size}"
                )
            own.position[:], own.motion[0], own.motion[1] = position, velocity, acceleration
            writeable = position.flags.writeable or velocity.flags.writeable or acceleration.flags.writeable
            own.copied = None if writeable else wanted
