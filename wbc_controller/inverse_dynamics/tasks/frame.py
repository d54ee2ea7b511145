"""Pose, position and orientation tasks."""

from typing import Any

import numpy as np
import pinocchio as pin

from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.frame_kernels import FRAME
from wbc_controller.inverse_dynamics.robot.instruction import Instruction, placement_numbers, placement_on_link
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.robot.orientation import rotation_of
from wbc_controller.inverse_dynamics.tasks.form import ReferenceForm
from wbc_controller.inverse_dynamics.tasks.task import Mask, MotionTask
from wbc_controller.records import Array

_WORLD_AXES = pin.LOCAL_WORLD_ALIGNED


def pose_error(pose: pin.SE3, position: Array, form: ReferenceForm) -> Array:
    """Return displacement, m, and rotation vector log(R_ref Rᵀ), rad, from a pose to a reference; parts as its form."""
    n = form.vector
    if not form.oriented:
        return np.asarray(position - pose.translation)
    turn = pin.log3(rotation_of(position[n:]).dot(pose.rotation.T))
    return np.concatenate([position[:n] - pose.translation[:n], turn])


class _FrameTask(MotionTask):
    part: slice  # of the frame's twist

    def __init__(self, name: str, model: RobotModel, frame: str, mask: Mask | None = None, **gains: Any) -> None:
        """Make a task, by default for all axes, with the gains of `MotionTask`."""
        super().__init__(name, [True] * self.size if mask is None else mask, **gains)
        self.frame = frame
        self._frame_id = model.frame_id(frame, f"tasks.{name}.frame")
        self._on_link = placement_on_link(model, self._frame_id)

    def instruction(self) -> Instruction | None:
        if type(self) not in (FramePositionTask, FrameOrientationTask, FramePoseTask):
            return None
        link, placement = self._on_link
        constants = placement_numbers(placement)
        return Instruction(FRAME, self.rows, link, first=self.part.start, size=self.size, constants=constants)

    def position(self, dynamics: Dynamics) -> Array:
        """Return position in m, quaternion (x, y, z, w), or both, as the reference."""
        values, first = pin.SE3ToXYZQUAT(dynamics.placement(self._frame_id)), 3 - self.form.vector
        return np.asarray(values[first : first + self.form.size])

    def error(self, dynamics: Dynamics, position: Array) -> Array:
        """Return displacement, rotation vector, or both to the reference in world axes, (size,)."""
        return pose_error(dynamics.placement(self._frame_id), position, self.form)

    def velocity(self, dynamics: Dynamics) -> Array:
        """Return the frame's velocity in world axes, linear part first, (size,)."""
        return dynamics.velocity(self._frame_id, _WORLD_AXES)[self.part]

    def jacobian(self, dynamics: Dynamics) -> Array:
        return dynamics.jacobian(self._frame_id, _WORLD_AXES)[self.part]

    def drift(self, dynamics: Dynamics) -> Array:
        return dynamics.drift_world(self._frame_id)[self.part]


class FramePositionTask(_FrameTask):
    """Task on the position of a frame's origin in the world, (3,) in m."""

    unit = "m"
    size = 3
    part = slice(0, 3)
    form = ReferenceForm()


class FrameOrientationTask(_FrameTask):
    """Task on a frame's orientation in the world; the reference is a quaternion (x, y, z, w)."""

    unit = "rad"
    size = 3
    part = slice(3, 6)
    form = ReferenceForm(vector=0, oriented=True)


class FramePoseTask(_FrameTask):
    """Task on a frame's pose in the world; the reference is position and quaternion, (7,)."""

    unit = "m, rad"
    size = 6
    part = slice(0, 6)
    form = ReferenceForm(oriented=True)
