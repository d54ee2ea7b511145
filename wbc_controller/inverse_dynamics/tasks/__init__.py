"""Tasks: one file per kind."""

from wbc_controller.inverse_dynamics.tasks.alignment import AxisAlignmentTask, GazeTask
from wbc_controller.inverse_dynamics.tasks.capture_point import CapturePointTask
from wbc_controller.inverse_dynamics.tasks.centroidal import AngularMomentumTask, ComTask, LinearMomentumTask
from wbc_controller.inverse_dynamics.tasks.effort import ContactWrenchTask, TorqueTask
from wbc_controller.inverse_dynamics.tasks.frame import FrameOrientationTask, FramePoseTask, FramePositionTask
from wbc_controller.inverse_dynamics.tasks.posture import PostureTask
from wbc_controller.inverse_dynamics.tasks.relative import RelativePoseTask
from wbc_controller.inverse_dynamics.tasks.task import AccelerationTask, EffortTask, MotionTask, RateTask, Task

__all__ = [
    "AccelerationTask", "AngularMomentumTask", "AxisAlignmentTask", "CapturePointTask", "ComTask", "ContactWrenchTask",
    "EffortTask", "FrameOrientationTask", "FramePoseTask", "FramePositionTask", "GazeTask", "LinearMomentumTask",
    "MotionTask", "PostureTask", "RateTask", "RelativePoseTask", "Task", "TorqueTask",
]  # fmt: skip
