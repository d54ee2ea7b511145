"""Where each task is, and where it is wanted: messages of the type of its setpoint."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

from wbc_controller.core.robot.dynamics import Dynamics
from wbc_controller.core.tasks import AccelerationTask, Task
from wbc_controller.records import References
from wbc_controller.wire.decoding import Vocabulary
from wbc_controller.wire.setpoints import setpoint_message
from wbc_controller.wire.topics import TASK_TYPES


class TaskStates:
    """Writes the tasks in rounds, one of them per call, so that no cycle pays for all."""

    def __init__(self, tasks: Mapping[str, Task], vocabulary: Vocabulary) -> None:
        """Take the tasks that have topics.

        Args:
            tasks: all tasks, by name.
            vocabulary: names the kinds, joints and frames of those with topics.
        """
        self._tasks = {name: tasks[name] for name in vocabulary.kinds}
        self._vocabulary = vocabulary
        self._left: deque[str] = deque()

    def begin(self) -> None:
        """Begin a round, where the last one is over."""
        if not self._left:
            self._left.extend(self._tasks)

    def next(self, stamp: int, dynamics: Dynamics, references: References) -> tuple[str, dict[str, Any]] | None:
        """The next task of the round; None where it is over.

        Args:
            stamp: time of the state, ns.
            dynamics: the snapshot of the cycle.
            references: those of the cycle.

        Returns:
            Name of the task, and by row of the topic table its messages: ``task_reference``, and of a task with a
            motion ``task_value``.
        """
        if not self._left:
            return None
        name = self._left.popleft()
        task, words = self._tasks[name], self._vocabulary
        positions = {"task_reference": references.tasks[name].position}
        if isinstance(task, AccelerationTask):
            positions["task_value"] = task.position(dynamics)
        return name, {
            key: setpoint_message(
                TASK_TYPES[words.kinds[name]]["setpoint"],
                words.kinds[name],
                position,
                frame=words.reference_frames.get(name, "world"),
                stamp=stamp,
                joints=words.joints.get(name, ()),
            )
            for key, position in positions.items()
        }
