"""The tasks: one file per kind, on the base class of `task`."""

from wbc_controller.core.tasks.alignment import AxisAlignmentTask, GazeTask
from wbc_controller.core.tasks.com import ComTask
from wbc_controller.core.tasks.frame import FrameOrientationTask, FramePoseTask, FramePositionTask
from wbc_controller.core.tasks.posture import PostureTask
from wbc_controller.core.tasks.relative import RelativePoseTask
from wbc_controller.core.tasks.task import Task

__all__ = [
    "AxisAlignmentTask",
    "ComTask",
    "FrameOrientationTask",
    "FramePoseTask",
    "FramePositionTask",
    "GazeTask",
    "PostureTask",
    "RelativePoseTask",
    "Task",
]
