"""Construction of tasks."""

from collections.abc import Callable, Mapping

import numpy as np

from wbc_controller.errors import ConfigurationError, require_known
from wbc_controller.inverse_dynamics import tasks
from wbc_controller.inverse_dynamics.contacts import Contact
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.settings import tasks as schema

#: Class of each type, and its arguments: keys of the settings, the model, its gravity, and the contact.
_CLASSES: dict[str, tuple[Callable[..., tasks.Task], str]] = {
    "posture": (tasks.PostureTask, "model joints stiffness damping"),
    "com": (tasks.ComTask, "mask stiffness damping"),
    "frame_pose": (tasks.FramePoseTask, "model frame mask stiffness damping"),
    "frame_position": (tasks.FramePositionTask, "model frame mask stiffness damping"),
    "frame_orientation": (tasks.FrameOrientationTask, "model frame mask stiffness damping"),
    "relative_pose": (tasks.RelativePoseTask, "model frame reference_frame mask stiffness damping"),
    "axis_alignment": (tasks.AxisAlignmentTask, "model frame axis stiffness damping"),
    "gaze": (tasks.GazeTask, "model frame axis stiffness damping"),
    "linear_momentum": (tasks.LinearMomentumTask, "mask damping"),
    "angular_momentum": (tasks.AngularMomentumTask, "mask damping"),
    "capture_point": (tasks.CapturePointTask, "gravity mask support_height gain"),
    "contact_wrench": (tasks.ContactWrenchTask, "contact mask target"),
    "torque": (tasks.TorqueTask, "model joints target"),
}


def make_task(name: str, task: schema.TaskSettings, model: RobotModel, contacts: Mapping[str, Contact]) -> tasks.Task:
    """Build one task."""
    given = {**dict(task), "model": model, "gravity": model.gravity}
    if isinstance(task, schema.ContactWrenchTask):
        require_known(task.contact, contacts, f"tasks.{name}.contact: unknown contact")
        given["contact"] = contacts[task.contact]
    kind, arguments = _CLASSES[task.type]
    made = kind(name, **{argument: given[argument] for argument in arguments.split()})
    made.level = task.level
    if task.tolerance is not None:
        made.tolerance = np.array(task.tolerance, dtype=np.float64)
        if made.tolerance.shape not in ((), (made.size,)):
            expected = f"expected one number, or {made.size} values (one per axis)"
            raise ConfigurationError(f"tasks.{name}.tolerance: {made.tolerance.size} values; {expected}")
    return made
