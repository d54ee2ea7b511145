"""Settings of the tasks: one class per kind."""

from __future__ import annotations

import reprlib
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from wbc_controller.settings.values import Finite, Gains, NonNegative, Section, Vector3, axes_mask


class _Task(Section):
    #: Number of axes, masked or not; 0 if it depends on the robot.
    axes: ClassVar[int] = 3

    live = ("weight", "enabled", "setpoint_duration", "stiffness", "damping", "gain")

    weight: NonNegative = Field(1.0, le=1.0e6, description="Weight in the cost.")
    enabled: bool = Field(True, description="Whether the task is enabled at activation.")
    level: int = Field(
        0,
        ge=0,
        le=15,
        description="Priority level: 0 is the highest, and no task worsens a task of a smaller level. Tasks of one "
        "level compete by weight.",
    )
    tolerance: Gains | None = Field(
        None,
        description="Task error up to which there is no cost, in the unit of the error; one number, or a list with one "
        "per axis.",
    )
    setpoint_duration: NonNegative = Field(
        1.0, le=600.0, description="Time in which the reference reaches a new setpoint, s; 0 for streamed setpoints."
    )

    @model_validator(mode="after")
    def _one_gain_for_each_axis(self) -> _Task:
        for key in ("stiffness", "damping", "gain", "tolerance"):
            value = getattr(self, key, None)
            if isinstance(value, list) and self.axes and len(value) != self.axes:
                raise ValueError(
                    f"{key} = {reprlib.repr(value)}: has {len(value)} values; it takes one number, or a list with one "
                    f"for each of the task's {self.axes} axes"
                )
        return self


class _MotionTask(_Task):
    stiffness: Gains = Field(100.0, description="Proportional gain, 1/s²; one number, or a list with one per axis.")
    damping: Gains | None = Field(
        None,
        description="Derivative gain, 1/s; one number, or a list with one per axis; default 2·√stiffness (critical).",
    )


class PostureTask(_MotionTask):
    """Joint positions."""

    axes: ClassVar[int] = 0  # as many as joints

    type: Literal["posture"]
    joints: list[str] = Field(default_factory=list, description="Joints of the task; empty for all driven joints.")


class ComTask(_MotionTask):
    """Centre of mass, m, world frame."""

    type: Literal["com"]
    mask: list[bool] = axes_mask(3, "World axes of the task.")


class _FrameTask(_MotionTask):
    frame: str = Field(description="A frame of the URDF.")


class FramePoseTask(_FrameTask):
    """Position and orientation of a frame, world frame."""

    axes: ClassVar[int] = 6

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
    """Position and orientation of a frame relative to a second frame on the robot, in the axes of the second frame."""

    axes: ClassVar[int] = 6

    type: Literal["relative_pose"]
    reference_frame: str = Field(description="The frame of the URDF in whose axes the pose of `frame` is given.")
    mask: list[bool] = axes_mask(6, "Axes of `reference_frame` used by the task: position, then orientation.")


class _AlignmentTask(_FrameTask):
    axes: ClassVar[int] = 2

    axis: Vector3 = Field(description="An axis fixed in the frame, of any non-zero length.")


class AxisAlignmentTask(_AlignmentTask):
    """An axis fixed in a frame points along a direction in the world; the rotation about it is free."""

    type: Literal["axis_alignment"]


class GazeTask(_AlignmentTask):
    """An axis through a frame's origin, fixed in it, points at a point in the world; the rotation about it is free."""

    type: Literal["gaze"]


class _MomentumTask(_Task):
    damping: Gains = Field(
        10.0,
        description="Decay rate of the error, 1/s; one number, or a list with one per axis. There is no stiffness.",
    )
    mask: list[bool] = axes_mask(3, "World axes of the task.")


class LinearMomentumTask(_MomentumTask):
    """Linear momentum, kg·m/s, world axes; the error in the cost is a force, N."""

    type: Literal["linear_momentum"]


class AngularMomentumTask(_MomentumTask):
    """Angular momentum about the centre of mass, N·m·s, world axes; the error in the cost is a torque, N·m."""

    type: Literal["angular_momentum"]


class CapturePointTask(_Task):
    """Capture point (divergent component of motion), m, x and y in the world; its error in the cost is in m/s."""

    axes: ClassVar[int] = 2

    type: Literal["capture_point"]
    gain: Gains = Field(4.0, description="Decay rate of the error, 1/s; one number, or a list with one per axis.")
    support_height: Finite = Field(0.0, description="Height of the supporting surface in the world, m.")
    mask: list[bool] = axes_mask(2, "World axes of the task: x, y.")


class ContactWrenchTask(_Task):
    """Wrench of a contact in the contact's axes, N and N·m; without effect while the contact is inactive."""

    axes: ClassVar[int] = 6

    type: Literal["contact_wrench"]
    contact: str = Field(description="Name of the contact in `contacts`.")
    target: list[Finite] = Field(
        [0.0] * 6, min_length=6, max_length=6, description="Wrench until a setpoint is commanded: force, then moment."
    )
    mask: list[bool] = axes_mask(6, "Contact axes of the task: force, then moment.")


class TorqueTask(_Task):
    """Joint torques, N·m; the default target of zero keeps them small."""

    axes: ClassVar[int] = 0  # as many as joints

    type: Literal["torque"]
    joints: list[str] = Field(default_factory=list, description="Joints of the task; empty for all driven joints.")
    target: list[Finite] = Field(
        default_factory=list, description="Torque of each joint until a setpoint is commanded, N·m; empty for zero."
    )


TaskSettings = Annotated[
    PostureTask
    | ComTask
    | FramePoseTask
    | FramePositionTask
    | FrameOrientationTask
    | RelativePoseTask
    | AxisAlignmentTask
    | GazeTask
    | LinearMomentumTask
    | AngularMomentumTask
    | CapturePointTask
    | ContactWrenchTask
    | TorqueTask,
    Field(discriminator="type"),
]
