"""Reports on tasks: values and references, persistent errors, binding constraints."""

import re
from collections import deque
from collections.abc import Collection, Mapping

import numpy as np

from wbc_controller.inverse_dynamics.method_calls import array_from
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.tasks import AccelerationTask, MotionTask, Task
from wbc_controller.middleware.codec import encode, setpoint_message
from wbc_controller.middleware.decoding import Vocabulary
from wbc_controller.middleware.topics import TASK_TYPES
from wbc_controller.records import Array, References, Solution

_MIN_ERROR = {"m": 0.01, "rad": 0.05}  # by unit of position and orientation
_MIN_NORM = min(_MIN_ERROR.values())  # of a task near its reference, in any unit
_MAX_CHANGE, _TIMEOUT = 0.02, 1.0  # largest relative change of the error of a task at rest, and duration of the rest, s
_MINOR_WEIGHT = 0.01  # share of the largest weight; lighter tasks are ignored
_MAX_CONSTRAINTS = 3  # largest number of named constraints
#: Names of the constraints of joints and actuators, and of contacts.
_LIMITS = {"motion": "limit of motion", "torque": "torque limit"}
_FORCES = {"normal_force": "normal force", "yaw_moment": "yaw moment", "force": "force", "moment": "moment"}
_NEGLIGIBLE = 1.0e-3  # share of the largest multiplier


class Shortfall:
    """Monitor of the task errors over successive reports."""

    def __init__(self, tasks: Mapping[str, Task]) -> None:
        """Select the motion tasks, with errors in m or rad."""
        self._tasks = {name: task for name, task in tasks.items() if isinstance(task, MotionTask)}
        self._since: dict[str, tuple[float, Array]] = {}

    def sentences(self, now: float, dynamics: Dynamics, references: References, solution: Solution) -> tuple[str, ...]:
        """Return a sentence for each task with a persistent error at the time `now`, s."""
        heaviest = max(references.weights.values(), default=0.0)
        messages = []
        for name, task in self._tasks.items():
            reference = references.tasks[name]
            follows = references.weights.get(name, 0.0) > _MINOR_WEIGHT * heaviest
            if not follows or solution.task_errors.get(name, np.inf) < _MIN_NORM or reference.velocity.any():
                self._since.pop(name, None)
                continue
            error = np.zeros(task.size)
            whole = array_from(task, "error", (task.size,), dynamics, reference.position)
            error[task.rows] = whole[task.rows]
            distance = _distance(error, task.unit)
            began, first = self._since.get(name, (now, error))
            if not (distance and np.linalg.norm(error - first) <= _MAX_CHANGE * np.linalg.norm(first)):
                began, first = now, error
            self._since[name] = began, first
            if now - began >= _TIMEOUT:
                binding = describe_binding(solution.binding)
                messages.append(f"{name} is {distance} short of its reference; binding: {binding}")
        return tuple(messages)


def _distance(error: Array, unit: str) -> str:
    size = {"m": len(error), "rad": 0}.get(unit, 3)  # of the linear part
    linear, angular = np.linalg.norm(error[:size]), np.linalg.norm(error[size:])
    parts = [f"{1e3 * linear:.0f} mm"] if linear >= _MIN_ERROR["m"] else []
    parts += [f"{angular:.2f} rad"] if angular >= _MIN_ERROR["rad"] else []
    return " and ".join(parts)


def describe_binding(binding: Mapping[str, float]) -> str:
    """Describe the constraints with the largest multipliers."""
    largest = max(binding.values(), default=0.0)
    names = sorted((name for name in binding if binding[name] > _NEGLIGIBLE * largest), key=lambda name: -binding[name])
    words = [describe_constraint(name) for name in names[:_MAX_CONSTRAINTS]]
    more = f", and {len(names) - _MAX_CONSTRAINTS} more" if len(names) > _MAX_CONSTRAINTS else ""
    return ", ".join(words) + more if words else "none; other tasks or forces outweigh it"


def describe_constraint(name: str) -> str:
    """Describe a binding constraint, such as ``motion:left_knee_joint:upper``."""
    kind, _, rest = name.partition(":")
    subject, _, side = rest.rpartition(":")
    if kind == "cone":
        return f"{rest}'s friction, or the edge of its support"
    if re.fullmatch(r"upper|lower", side):
        if kind in _LIMITS:
            return f"{subject}'s {side} {_LIMITS[kind]}"
        if kind in _FORCES:
            return f"{subject}'s {'largest' if side == 'upper' else 'smallest'} {_FORCES[kind]}"
    return name


class TaskStates:
    """Serializer of the tasks in rounds, one task per call, to bound the time of a cycle."""

    def __init__(self, tasks: Mapping[str, Task], vocabulary: Vocabulary) -> None:
        self._tasks = {name: tasks[name] for name in vocabulary.kinds}
        self._vocabulary = vocabulary
        self._remaining: deque[str] = deque()

    def begin(self, names: Collection[str]) -> None:
        """Begin a round of the named tasks with topics, unless a round is in progress."""
        if not self._remaining:
            self._remaining.extend(name for name in self._tasks if name in names)

    def next(self, stamp: int, dynamics: Dynamics, references: References) -> tuple[str, dict[str, bytes]] | None:
        """Return name and messages, by row of the topic table, of the next task at a stamp, ns; None after the last."""
        if not self._remaining:
            return None
        name = self._remaining.popleft()
        task = self._tasks[name]
        positions = {"task_reference": references.tasks[name].position}
        if isinstance(task, AccelerationTask):
            positions["task_value"] = array_from(task, "position", (task.form.size,), dynamics)
        words, kind = self._vocabulary, self._vocabulary.kinds[name]
        type_name, joints = TASK_TYPES[kind]["setpoint"], words.joints.get(name, ())
        frame = words.reference_frames.get(name, "world")
        return name, {
            key: encode(setpoint_message(type_name, kind, position, frame=frame, stamp=stamp, joints=joints))
            for key, position in positions.items()
        }
