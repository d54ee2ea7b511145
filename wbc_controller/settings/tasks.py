"""The tasks: a class per kind."""

from __future__ import annotations

import reprlib
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from wbc_controller.settings.values import Finite, Gains, NonNegative, Section, Vector3


class _Task(Section):
    #: Number of axes, masked or not; 0 where the file alone does not tell it.
    axes: ClassVar[int] = 3

    live = ("weight", "enabled", "setpoint_duration", "stiffness", "damping", "gain")

    weight: NonNegative = Field(1.0, le=1.0e6, description="Weight in the cost.")
    enabled: bool = Field(True, description="Whether the task is on at activation.")
    level: int = Field(
        0,
        ge=0,
        le=15,
        description="Priority: 0 is the highest, and no task worsens one of a smaller level. Tasks of one level "
        "compete by weight.",
    )
    tolerance: Gains | None = Field(
        None,
        description="How far from its reference the task may be at no cost, in the unit of its error; one number, or a "
        "list with one per axis.",
    )
    setpoint_duration: NonNegative = Field(
        1.0, le=600.0, description="Time in which a new setpoint is reached, s; 0 for setpoints that are streamed."
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
        description="Derivative gain, 1/s; one number, or a list with one per axis; 2·√stiffness (critical) where it "
        "is not given.",
    )


class PostureTask(_MotionTask):
    """Joint positions."""

    axes: ClassVar[int] = 0  # as many as joints

    type: Literal["posture"]
    joints: list[str] = Field(default_factory=list, description="The joints concerned; empty for all that are driven.")


class ComTask(_MotionTask):
    """Centre of mass, m, world frame."""

    type: Literal["com"]
    mask: list[bool] = Field([True, True, True], min_length=3, max_length=3, description="World axes concerned.")


class _FrameTask(_MotionTask):
    frame: str = Field(description="A frame of the URDF.")


class FramePoseTask(_FrameTask):
    """Position and orientation of a frame, world frame."""

    axes: ClassVar[int] = 6

    type: Literal["frame_pose"]
    mask: list[bool] = Field(
        [True] * 6, min_length=6, max_length=6, description="World axes concerned: position, then orientation."
    )


class FramePositionTask(_FrameTask):
    """Position of a frame's origin, world frame."""

    type: Literal["frame_position"]
    mask: list[bool] = Field([True] * 3, min_length=3, max_length=3, description="World axes concerned.")


class FrameOrientationTask(_FrameTask):
    """Orientation of a frame, world frame."""

    type: Literal["frame_orientation"]
    mask: list[bool] = Field([True] * 3, min_length=3, max_length=3, description="World axes concerned.")


class RelativePoseTask(_FrameTask):
    """Position and orientation of a frame relative to another one on the robot, in the axes of that one."""

    axes: ClassVar[int] = 6

    type: Literal["relative_pose"]
    reference_frame: str = Field(description="The frame of the URDF in whose axes the pose of `frame` is given.")
    mask: list[bool] = Field(
        [True] * 6,
        min_length=6,
        max_length=6,
        description="Axes of `reference_frame` concerned: position, then orientation.",
    )


class _AlignmentTask(_FrameTask):
    axes: ClassVar[int] = 2

    axis: Vector3 = Field(description="An axis fixed in the frame, of any length but zero.")


class AxisAlignmentTask(_AlignmentTask):
    """An axis fixed in a frame points along a direction of the world; the spin about it is free."""

    type: Literal["axis_alignment"]


class GazeTask(_AlignmentTask):
    """An axis fixed in a frame, through its origin, points at a point of the world; the spin about it is free."""

    type: Literal["gaze"]


class _MomentumTask(_Task):
    damping: Gains = Field(
        10.0,
        description="How fast the error decays, 1/s; one number, or a list with one per axis. There is no stiffness.",
    )
    mask: list[bool] = Field([True] * 3, min_length=3, max_length=3, description="World axes concerned.")


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
    gain: Gains = Field(4.0, description="How fast the error decays, 1/s; one number, or a list with one per axis.")
    support_height: Finite = Field(0.0, description="Height of what the robot stands on, in the world, m.")
    mask: list[bool] = Field([True] * 2, min_length=2, max_length=2, description="World axes concerned: x, y.")


class ContactWrenchTask(_Task):
    """Wrench of a contact in its own axes, N and N·m; while the contact is broken it asks for nothing."""

    axes: ClassVar[int] = 6

    type: Literal["contact_wrench"]
    contact: str = Field(description="The contact, one of `contacts`.")
    target: list[Finite] = Field(
        [0.0] * 6, min_length=6, max_length=6, description="Wrench before another one is commanded: force, then moment."
    )
    mask: list[bool] = Field(
        [True] * 6, min_length=6, max_length=6, description="Axes of the contact concerned: force, then moment."
    )


class TorqueTask(_Task):
    """Joint torques, N·m; with the target of zero they become small."""

    axes: ClassVar[int] = 0  # as many as joints

    type: Literal["torque"]
    joints: list[str] = Field(default_factory=list, description="The joints concerned; empty for all that are driven.")
    target: list[Finite] = Field(
        default_factory=list, description="Torque of each before others are commanded, N·m; empty for zero."
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
