"""Settings of the tasks."""

import reprlib
from typing import Annotated, Literal

from pydantic import Field, model_validator

from wbc_controller.settings.values import Finite, Gains, NonNegative, Section, Vector3, axes_mask, key


class _Task(Section):
    live = ("weight", "enabled", "setpoint_duration", "stiffness", "damping", "gain")

    weight: NonNegative = key(1.0, "Weight in the cost.", le=1.0e6)
    enabled: bool = key(True, "Enabled when the controller is activated.")
    level: int = key(0, "Strict priority level, 0 is the highest. Weights apply within a level.", ge=0, le=15)
    tolerance: Gains | None = key(None, "Error without cost, in the unit of the error; per axis.")
    setpoint_duration: NonNegative = key(1.0, "Time to reach a new setpoint, s; 0 for streamed setpoints.", le=600.0)

    @model_validator(mode="after")
    def _one_gain_for_each_axis(self) -> "_Task":
        axes = 2 if isinstance(self, _AlignmentTask) else len(getattr(self, "mask", ()))  # 0: as many as joints
        for name in ("stiffness", "damping", "gain", "tolerance"):
            value = getattr(self, name, None)
            if isinstance(value, list) and axes and len(value) != axes:
                expected = f"expected one number, or {axes} values (one per axis)"
                raise ValueError(f"{name} = {reprlib.repr(value)}: {len(value)} values; {expected}")
        return self


class _MotionTask(_Task):
    stiffness: Gains = key(100.0, "Proportional gain, 1/s²; per axis.")
    damping: Gains | None = key(None, "Derivative gain, 1/s; per axis; default 2·√stiffness (critical).")


class PostureTask(_MotionTask):
    """Joint positions."""

    type: Literal["posture"]
    joints: list[str] = key([], "Joints of the task; empty for all driven ones.")


class ComTask(_MotionTask):
    """Centre of mass, m, world frame."""

    type: Literal["com"]
    mask: list[bool] = axes_mask(3, "World axes of the task.")


class _FrameTask(_MotionTask):
    frame: str = Field(description="URDF frame.")


class FramePoseTask(_FrameTask):
    """Position and orientation of a frame, world frame."""

    type: Literal["frame_pose"]
    mask: list[bool] = axes_mask(6, "World axes of the task: position, then orientation.")


class FramePositionTask(_FrameTask):
    """Position of a frame's origin, world frame."""

    type: Literal["frame_position"]
    mask: list[bool] = axes_mask(3, "World axes of the task.")


class FrameOrientationTask(_FrameTask):
    """Orientation of a frame, world frame."""

    type: Literal["frame_orientation"]
    mask: list[bool] = axes_mask(3, "World axes of the task.")


class RelativePoseTask(_FrameTask):
    """Position and orientation of a frame relative to a second frame of the robot, in the axes of the second frame."""

    type: Literal["relative_pose"]
    reference_frame: str = Field(description="URDF frame that `frame` is relative to.")
    mask: list[bool] = axes_mask(6, "Axes of `reference_frame` in the task: position, then orientation.")


class _AlignmentTask(_FrameTask):
    axis: Vector3 = Field(description="Axis in `frame`; any length.")


class AxisAlignmentTask(_AlignmentTask):
    """Direction in the world of an axis fixed to a frame; the rotation about it is free."""

    type: Literal["axis_alignment"]


class GazeTask(_AlignmentTask):
    """Axis through a frame's origin, pointing at a point in the world; the rotation about it is free."""

    type: Literal["gaze"]


class _MomentumTask(_Task):
    damping: Gains = key(10.0, "Decay rate of the error, 1/s; per axis.")
    mask: list[bool] = axes_mask(3, "World axes of the task.")


class LinearMomentumTask(_MomentumTask):
    """Linear momentum, kg·m/s, world axes; the error in the cost is a force, N."""

    type: Literal["linear_momentum"]


class AngularMomentumTask(_MomentumTask):
    """Angular momentum about the centre of mass, N·m·s, world axes; the error in the cost is a torque, N·m."""

    type: Literal["angular_momentum"]


class CapturePointTask(_Task):
    """Capture point (divergent component of motion), m, x and y in the world; the error in the cost is in m/s."""

    type: Literal["capture_point"]
    gain: Gains = key(4.0, "Decay rate of the error, 1/s; per axis.")
    support_height: Finite = key(0.0, "Height of the supporting surface in the world, m.")
    mask: list[bool] = axes_mask(2, "World axes of the task: x, y.")


class ContactWrenchTask(_Task):
    """Wrench of an active contact in its axes, N and N·m."""

    type: Literal["contact_wrench"]
    contact: str = Field(description="Name of the contact in `contacts`.")
    target: list[Finite] = key([0.0] * 6, "Initial setpoint: force, then moment.", min_length=6, max_length=6)
    mask: list[bool] = axes_mask(6, "Contact axes of the task: force, then moment.")


class TorqueTask(_Task):
    """Joint torques, N·m; by default zero, for small torques."""

    type: Literal["torque"]
    joints: list[str] = key([], "Joints of the task; empty for all driven ones.")
    target: list[Finite] = key([], "Initial setpoint of each joint, N·m; empty for zero.")


TaskSettings = Annotated[
    PostureTask | ComTask | FramePoseTask | FramePositionTask | FrameOrientationTask | RelativePoseTask
    | AxisAlignmentTask | GazeTask | LinearMomentumTask | AngularMomentumTask | CapturePointTask | ContactWrenchTask
    | TorqueTask,
    Field(discriminator="type"),
]  # fmt: skip
