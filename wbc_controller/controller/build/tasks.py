"""Construction of tasks."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from wbc_controller import settings as schema
from wbc_controller.errors import ConfigurationError, valid_choices
from wbc_controller.inverse_dynamics.contacts import Contact
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.tasks import (
    AngularMomentumTask,
    AxisAlignmentTask,
    CapturePointTask,
    ComTask,
    ContactWrenchTask,
    FrameOrientationTask,
    FramePoseTask,
    FramePositionTask,
    GazeTask,
    LinearMomentumTask,
    PostureTask,
    RelativePoseTask,
    Task,
    TorqueTask,
)


def make_task(name: str, task: schema.TaskSettings, model: RobotModel, contacts: Mapping[str, Contact]) -> Task:
    """Build one task."""
    made = _make(name, task, model, contacts)
    made.level = task.level
    if task.tolerance is not None:
        made.tolerance = np.array(task.tolerance, dtype=np.float64)
        if made.tolerance.shape not in ((), (made.size,)):
            raise ConfigurationError(
                f"tasks.{name}.tolerance: {made.tolerance.size} values; expected one number, or {made.size} values "
                "(one per axis)"
            )
    return made


def _make(name: str, task: schema.TaskSettings, model: RobotModel, contacts: Mapping[str, Contact]) -> Task:
    if isinstance(task, schema.PostureTask):
        return PostureTask(name, model, task.joints, stiffness=task.stiffness, damping=task.damping)
    if isinstance(task, schema.TorqueTask):
        return TorqueTask(name, model, task.joints, task.target)
    if isinstance(task, schema.ContactWrenchTask):
        if task.contact not in contacts:
            raise ConfigurationError(
                f"tasks.{name}.contact: unknown contact {task.contact!r}; {valid_choices(task.contact, contacts)}"
            )
        return ContactWrenchTask(name, contacts[task.contact], task.mask, task.target)
    if isinstance(task, schema.ComTask):
        return ComTask(name, task.mask, stiffness=task.stiffness, damping=task.damping)
    if isinstance(task, schema.LinearMomentumTask | schema.AngularMomentumTask):
        momentum = LinearMomentumTask if isinstance(task, schema.LinearMomentumTask) else AngularMomentumTask
        return momentum(name, task.mask, damping=task.damping)
    if isinstance(task, schema.CapturePointTask):
        return CapturePointTask(name, model.gravity, task.mask, support_height=task.support_height, gain=task.gain)
    if isinstance(task, schema.RelativePoseTask):
        return RelativePoseTask(
            name, model, task.frame, task.reference_frame, task.mask, stiffness=task.stiffness, damping=task.damping
        )
    if isinstance(task, schema.AxisAlignmentTask | schema.GazeTask):
        alignment = GazeTask if isinstance(task, schema.GazeTask) else AxisAlignmentTask
        return alignment(name, model, task.frame, task.axis, stiffness=task.stiffness, damping=task.damping)
    kinds: dict[str, Callable[..., Task]] = {
        "frame_pose": FramePoseTask,
        "frame_position": FramePositionTask,
        "frame_orientation": FrameOrientationTask,
    }
    return kinds[task.type](name, model, task.frame, task.mask, stiffness=task.stiffness, damping=task.damping)
