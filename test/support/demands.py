"""References with other demands on a task."""

from dataclasses import replace


def demand(references, task, **parts):
    """Return references with another position, velocity or acceleration of one task."""
    return replace(references, tasks={**references.tasks, task: replace(references.tasks[task], **parts)})
