"""Tasks of a walker."""

from collections.abc import Iterable, Mapping

from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics import tasks as kinds
from wbc_controller.inverse_dynamics.whole_body_qp import WholeBodyQP
from wbc_controller.settings import Settings
from wbc_controller.walking.walker import TaskSets

COM, HEIGHT, POSTURE = "walking_com", "walking_height", "walking_posture"  # names of tasks
#: Tasks with references in the world.
_IN_THE_WORLD = kinds.ComTask, kinds.CapturePointTask, kinds.FramePoseTask, kinds.FramePositionTask


def make_disabled(tasks: Mapping[str, tuple[float, kinds.Task]], settings: Settings) -> list[kinds.Task]:
    """Give tasks their weights, off until the robot walks; `ConfigurationError` if a configured task has their name."""
    taken = sorted(tasks.keys() & settings.tasks.keys())
    if taken:
        raise ConfigurationError(f"tasks.{taken[0]}: the walker has a task of this name; choose another name")
    for weight, task in tasks.values():
        task.weight, task.enabled = weight, False
    return [task for _, task in tasks.values()]


def make_task_sets(settings: Settings, qp: WholeBodyQP, feet: Iterable[str]) -> TaskSets:
    """Name the tasks of a walker; `feet` are its tasks on the feet."""
    configured = {name: qp.tasks[name] for name, task in settings.tasks.items() if task.enabled}
    orientations = tuple(name for name, task in configured.items() if isinstance(task, kinds.FrameOrientationTask))
    suspended = tuple(name for name, task in configured.items() if isinstance(task, _IN_THE_WORLD))
    return TaskSets(COM, HEIGHT, (COM, HEIGHT, POSTURE, *feet), orientations, suspended)


def value_or(value: float | None, default: float) -> float:
    """Return a value, or the default for None."""
    return default if value is None else value
