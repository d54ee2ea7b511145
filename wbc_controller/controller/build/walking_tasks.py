"""Tasks of a walker."""

from collections.abc import Mapping

from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics import tasks as kinds
from wbc_controller.inverse_dynamics.whole_body_qp import WholeBodyQP
from wbc_controller.settings import Settings

COM, HEIGHT, POSTURE = "walking_com", "walking_height", "walking_posture"  # names of tasks
#: Tasks with references in the world.
_IN_THE_WORLD = kinds.ComTask, kinds.CapturePointTask, kinds.FramePoseTask, kinds.FramePositionTask


def make_disabled(tasks: Mapping[str, tuple[float, kinds.Task]], settings: Settings) -> list[kinds.Task]:
    """Give tasks their weights, off until the robot walks; `tasks` has weights and tasks by name.

    Raises:
        ConfigurationError: if a configured task has the name of one of these.
    """
    taken = sorted(tasks.keys() & settings.tasks.keys())
    if taken:
        raise ConfigurationError(f"tasks.{taken[0]}: the walker has a task of this name; choose another name")
    for weight, task in tasks.values():
        task.weight, task.enabled = weight, False
    return [task for _, task in tasks.values()]


def enabled_tasks(settings: Settings, qp: WholeBodyQP) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of the enabled tasks on orientations, and of those with references in the world."""
    configured = {name: qp.tasks[name] for name, task in settings.tasks.items() if task.enabled}
    return (
        tuple(name for name, task in configured.items() if isinstance(task, kinds.FrameOrientationTask)),
        tuple(name for name, task in configured.items() if isinstance(task, _IN_THE_WORLD)),
    )


def value_or(value: float | None, default: float) -> float:
    """Return a value, or the default for None."""
    return default if value is None else value
