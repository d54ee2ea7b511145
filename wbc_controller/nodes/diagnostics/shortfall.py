"""Tasks that stay short of a constant reference, and the constraints that bind them."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from wbc_controller.inverse_dynamics.method_calls import array_from
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.tasks import MotionTask, Task
from wbc_controller.records import Array, References, Solution

#: Smallest errors of a task that is short of its reference, by unit of its position and its orientation.
_SHORT = {"m": 0.01, "rad": 0.05}
#: Norm of an error below which a task is near its reference, whatever its unit.
_NEAR = min(_SHORT.values())
#: Change of the error up to which a task no longer moves, as a share of it, and time for which it has not, s.
_STILL, _PATIENCE = 0.02, 1.0
#: Share of the largest weight below which a task yields to the others, as a posture task does.
_MINOR = 0.01
#: Largest number of constraints that are named.
_MOST = 3
#: Kinds of constraints in words: of joints and actuators, and of contacts.
_LIMITS = {"motion": "limit of motion", "torque": "torque limit"}
_FORCES = {"normal_force": "normal force", "yaw_moment": "yaw moment", "force": "force", "moment": "moment"}
#: Share of the largest multiplier up to which a constraint is not named.
_NEGLIGIBLE = 1.0e-3


class Shortfall:
    """Follows the errors of the tasks from one status to the next."""

    def __init__(self, tasks: Mapping[str, Task]) -> None:
        """Take the tasks whose errors are distances or angles."""
        self._tasks = {name: task for name, task in tasks.items() if isinstance(task, MotionTask)}
        self._since: dict[str, tuple[float, Array]] = {}

    def sentences(self, now: float, dynamics: Dynamics, references: References, solution: Solution) -> tuple[str, ...]:
        """Return a sentence for each task that has stayed short of its reference, at the time `now`, s."""
        heaviest = max(references.weights.values(), default=0.0)
        said = []
        for name, task in self._tasks.items():
            reference = references.tasks[name]
            follows = references.weights.get(name, 0.0) > _MINOR * heaviest
            if not follows or solution.task_errors.get(name, np.inf) < _NEAR or reference.velocity.any():
                self._since.pop(name, None)
                continue
            error = np.zeros(task.size)
            whole = array_from(task, "error", (task.size,), dynamics, reference.position)
            error[task.rows] = whole[task.rows]
            how_far = _distance(error, task.unit)
            began, first = self._since.get(name, (now, error))
            if not (how_far and np.linalg.norm(error - first) <= _STILL * np.linalg.norm(first)):
                began, first = now, error
            self._since[name] = began, first
            if now - began >= _PATIENCE:
                said.append(f"{name} is {how_far} short of its reference; binding: {in_the_way(solution.binding)}")
        return tuple(said)


def _distance(error: Array, unit: str) -> str:
    """Write the distance of an error; empty if it is small."""
    parts = []
    linear = error[:3] if unit == "m, rad" else error if unit == "m" else error[:0]
    angular = error[3:] if unit == "m, rad" else error if unit == "rad" else error[:0]
    if np.linalg.norm(linear) >= _SHORT["m"]:
        parts.append(f"{1e3 * np.linalg.norm(linear):.0f} mm")
    if np.linalg.norm(angular) >= _SHORT["rad"]:
        parts.append(f"{np.linalg.norm(angular):.2f} rad")
    return " and ".join(parts)


def in_the_way(binding: Mapping[str, float]) -> str:
    """Return the constraints with the largest multipliers, in words."""
    largest = max(binding.values(), default=0.0)
    names = sorted((name for name in binding if binding[name] > _NEGLIGIBLE * largest), key=lambda name: -binding[name])
    words = [in_words(name) for name in names[:_MOST]]
    more = f", and {len(names) - _MOST} more" if len(names) > _MOST else ""
    return ", ".join(words) + more if words else "nothing; other tasks or forces outweigh it"


def in_words(name: str) -> str:
    """Write a binding constraint in words: ``motion:left_knee_joint:upper`` as its upper limit of motion."""
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
