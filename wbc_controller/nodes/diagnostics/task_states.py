"""Value and reference of each task."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping

from wbc_controller.inverse_dynamics.method_calls import array_from
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.tasks import AccelerationTask, Task
from wbc_controller.middleware.decoding import Vocabulary
from wbc_controller.middleware.setpoints import SetpointTemplate
from wbc_controller.middleware.topics import TASK_TYPES
from wbc_controller.records import Array, References


class TaskStates:
    """Serializer of the tasks in rounds, one task per call, to bound the time of a cycle."""

    def __init__(self, tasks: Mapping[str, Task], vocabulary: Vocabulary) -> None:
        self._tasks = {name: tasks[name] for name in vocabulary.kinds}
        self._vocabulary = vocabulary
        self._remaining: deque[str] = deque()
        self._templates: dict[str, SetpointTemplate] = {}

    def begin(self, names: Collection[str]) -> None:
        """Begin a round of the named tasks with topics, unless a round is in progress."""
        if not self._remaining:
            self._remaining.extend(name for name in self._tasks if name in names)

    def next(self, stamp: int, dynamics: Dynamics, references: References) -> tuple[str, dict[str, bytes]] | None:
        """Return name and messages of the next task, with the stamp of the state, ns; None at the end of the round.

        Rows of the topic table are ``task_reference``, and ``task_value`` for a motion task.
        """
        if not self._remaining:
            return None
        name = self._remaining.popleft()
        task = self._tasks[name]
        positions = {"task_reference": references.tasks[name].position}
        if isinstance(task, AccelerationTask):
            positions["task_value"] = array_from(task, "position", (task.form.size,), dynamics)
        template = self._templates.get(name) or self._make_template(name, references.tasks[name].position)
        return name, {key: template.write(stamp, position) for key, position in positions.items()}

    def _make_template(self, name: str, position: Array) -> SetpointTemplate:
        words, kind = self._vocabulary, self._vocabulary.kinds[name]
        template = self._templates[name] = SetpointTemplate(
            TASK_TYPES[kind]["setpoint"],
            kind,
            position,
            frame=words.reference_frames.get(name, "world"),
            joints=words.joints.get(name, ()),
        )
        return template
