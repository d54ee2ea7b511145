"""The schema of a robot's configuration file: names, types, units, ranges and defaults.

The file is a ROS 2 parameter file: ``wbc_controller: ros__parameters: …``. Unknown keys are errors.
"""

from __future__ import annotations

import math
import reprlib
from typing import Annotated, ClassVar, Literal, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Discriminator, Field, Tag, model_validator

NODE_NAME = "wbc_controller"


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise ValueError("must be finite")
    return value


Finite = Annotated[float, AfterValidator(_finite)]
Positive = Annotated[Finite, Field(gt=0.0)]
NonNegative = Annotated[Finite, Field(ge=0.0)]
Vector3 = Annotated[list[Finite], Field(min_length=3, max_length=3)]
#: Gains of at most this size are accepted: more is a mistaken unit.
Gain = Annotated[NonNegative, Field(le=1.0e5)]
NUMBER, LIST = "(number)", "(list)"  # in the places of errors; no key of a file is written so
#: One number, or a list with one for each axis.
Gains = Annotated[
    Annotated[Gain, Tag(NUMBER)] | Annotated[list[Gain], Tag(LIST)],
    Discriminator(lambda value: LIST if isinstance(value, list) else NUMBER),
]
#: Half sides and radii of a contact, in metres: more than this was probably meant in centimetres or millimetres.
Length = Annotated[Positive, Field(le=1.0)]
#: One coordinate of such a shape, m.
Coordinate = Annotated[Finite, Field(ge=-1.0, le=1.0)]
Corners = Annotated[list[Annotated[list[Coordinate], Field(min_length=2, max_length=2)]], Field(max_length=12)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)

    #: The keys that may be changed while the controller runs.
    live: ClassVar[tuple[str, ...]] = ()


class PassiveJointSettings(_Section):
    """A joint without a motor of its own: its spring and its damper, torque = stiffness · (rest - q) - damping · q̇."""

    stiffness: NonNegative = Field(0.0, le=1.0e6, description="Of its spring, N·m/rad.")
    damping: NonNegative = Field(0.0, le=1.0e5, description="Of its damper, N·m·s/rad.")
    rest: Finite = Field(0.0, description="Where the spring is at rest, rad.")


class TransmissionSettings(_Section):
    """An actuator that is not simply the motor of one joint."""

    ratios: dict[str, Finite] = Field(
        min_length=1,
        description="For joints by name, how far the actuator turns per turn of the joint: its speed is the sum of "
        "ratio times joint speed, and it gives ratio times its torque at each of these joints.",
    )
    effort_limit: Positive = Field(description="Largest torque of the actuator, N·m.")
    rotor_inertia: NonNegative = Field(
        0.0, le=10.0, description="Inertia of what turns with the actuator, at its own speed, kg·m²."
    )


_Curve = TypeVar("_Curve", bound="ActuatorTorqueSpeed | TorqueSpeedSettings")


def _falling(curve: _Curve) -> _Curve:
    if not (curve.corner < curve.no_load):
        raise ValueError(f"no_load = {curve.no_load}: must be above corner = {curve.corner}")
    return curve


class RobotSettings(_Section):
    """The robot: its model, its joints, what drives them, and how it stands."""

    urdf: str = Field(
        "",
        description="Path, or package://<python distribution>/<path in its share folder>. Empty: "
        "the URDF comes from the topic robot_description.",
    )
    base: Literal["floating", "fixed"] = Field("floating", description="How the root link is attached to the world.")
    joints: list[str] = Field(
        min_length=1,
        description="Joints that move and are measured. Joints that the URDF lets mimic one of these follow it; all "
        "others are locked.",
    )
    actuators: list[str] = Field(
        default_factory=list,
        description="The actuators, in the order of the effort command: joints with a motor of their own, and names of "
        "`transmission`. Empty: one motor at each joint that is not passive, in the order of `joints`.",
    )
    transmission: dict[str, TransmissionSettings] = Field(
        default_factory=dict, description="Actuators that are not simply the motor of one joint."
    )
    command: Literal["actuators", "joints"] = Field(
        "actuators",
        description="What the effort command holds: torques of the actuators, or, for a robot whose drivers know its "
        "transmissions, the torques at the joints that are driven, in the order of `joints`.",
    )
    passive_joints: dict[str, PassiveJointSettings] = Field(
        default_factory=dict, description="Those of `joints` that have no motor of their own."
    )
    locked_joints: dict[str, Finite] = Field(
        default_factory=dict, description="Position of joints that are locked elsewhere than at zero, rad."
    )
    posture: list[Finite] = Field(description="Nominal position of each joint, rad.")
    effort_limit_scale: Annotated[Positive, Field(le=1.0)] = Field(
        1.0, description="Share of the effort limits, of the URDF and of `transmission`, that may be used."
    )
    armature: NonNegative = Field(
        0.0, le=10.0, description="Reflected rotor inertia of every joint that has a motor of its own, kg·m²."
    )

    @model_validator(mode="after")
    def _consistent(self) -> RobotSettings:
        twice = sorted({name for name in self.joints if self.joints.count(name) > 1})
        if twice:
            raise ValueError(f"joints: {', '.join(map(repr, twice))} stands more than once; name it once")
        again = sorted({name for name in self.actuators if self.actuators.count(name) > 1})
        if again:
            raise ValueError(f"actuators: {', '.join(map(repr, again))} stands more than once; each has one command")
        if len(self.posture) != len(self.joints):
            raise ValueError(
                f"posture has {len(self.posture)} values for {len(self.joints)} joints; "
                "it takes one per joint, in the same order"
            )
        return self


class ControlSettings(_Section):
    """The control loop."""

    live = ("weight_ramp",)

    rate: Annotated[Positive, Field(ge=10.0, le=10000.0)] = Field(500.0, description="Cycles per second.")
    trigger: Literal["timer", "joint_states"] = Field(
        "joint_states", description="timer: absolute deadlines at `rate`. joint_states: one cycle per joint state."
    )
    weight_ramp: NonNegative = Field(
        0.5, le=60.0, description="Time in which new weights, gains and limits are reached, s."
    )
    diagnostics_rate: Annotated[Positive, Field(le=1000.0)] = Field(
        10.0, description="Messages per second on /diagnostics."
    )
    markers_rate: NonNegative = Field(
        10.0,
        le=100.0,
        description="Messages per second on ~/markers, at most, drawn when the torques are out; 0 for none.",
    )


class SolverSettings(_Section):
    """The solver of the quadratic program."""

    name: str = Field(
        "daqp",
        description="daqp, osqp and proxqp are persistent and warm-started; any other installed "
        "solver of qpsolvers is called through it.",
    )
    regularization_acceleration: Positive = Field(
        1.0e-5,
        le=1.0,
        description="Weight of ½(‖q̈‖² + ‖ḣ_G/m‖²): joint accelerations, and the rate of the "
        "momentum about the centre of mass per mass; (rad/s²)⁻², (m/s²)⁻².",
    )
    regularization_force: Positive = Field(1.0e-6, le=1.0, description="Weight of ½‖f‖², N⁻² or (N·m)⁻².")


class ActuatorTorqueSpeed(_Section):
    """The torque-speed curve of one actuator."""

    corner: Positive = Field(le=1.0e4, description="Speed up to which the effort limit is available, rad/s.")
    no_load: Positive = Field(le=1.0e4, description="Speed at which no torque is available, rad/s.")

    @model_validator(mode="after")
    def _falls(self) -> ActuatorTorqueSpeed:
        return _falling(self)


class TorqueSpeedSettings(_Section):
    """What torque the motors have at which speed: in the direction of motion it falls above the corner speed."""

    enabled: bool = Field(False, description="Hold the torque-speed curve.")
    corner: Positive = Field(
        0.5,
        le=10.0,
        description="Speed up to which the effort limit is available, as a share of the URDF's velocity limit.",
    )
    no_load: Positive = Field(
        1.0, le=10.0, description="Speed at which no torque is available, as a share of the URDF's velocity limit."
    )
    actuators: dict[str, ActuatorTorqueSpeed] = Field(
        default_factory=dict, description="Actuators with values of their own; those of `robot.transmission` need them."
    )

    @model_validator(mode="after")
    def _falls(self) -> TorqueSpeedSettings:
        return _falling(self)


class SelfCollisionSettings(_Section):
    """Links that could collide are kept at a distance from each other."""

    enabled: bool = Field(False, description="Keep links apart, by the collision elements of the URDF.")
    margin: Annotated[Positive, Field(le=0.5)] = Field(0.02, description="Least distance, m.")
    acceleration: Annotated[Positive, Field(le=1.0e3)] = Field(
        20.0,
        description="Deceleration with which links have to be able to stop before the margin, m/s²: choose what the "
        "motors can do with the arm stretched out.",
    )
    horizon: NonNegative = Field(
        0.02,
        le=1.0,
        description="Time over which the limit looks ahead, at least one period, s, as `position_horizon`.",
    )
    max_pairs: int = Field(12, ge=1, le=200, description="Number of pairs that are held in one cycle: the most urgent.")
    srdf: str = Field(
        "", description="An SRDF, in the form of `robot.urdf`: pairs that it disables are not held. Empty: none."
    )
    visual: list[str] = Field(
        default_factory=list,
        description="Links of which the visual elements count too: those that have no collision elements.",
    )
    pairs: list[str] = Field(
        default_factory=list,
        description="The pairs to be held, each `<link>/<link>`. Empty: all but links that carry each other by "
        "one or two joints, those that the SRDF disables, and those nearer than the margin in `robot.posture`.",
    )


class LimitSettings(_Section):
    """Which limits the quadratic program holds. Torque limits always apply."""

    live = ("position_margin", "position_horizon", "velocity_scale", "acceleration", "torque_rate")

    position: bool = Field(True, description="Hold the URDF's joint position limits.")
    position_margin: NonNegative = Field(0.02, le=1.0, description="Distance kept from them, rad.")
    position_horizon: NonNegative = Field(
        0.02,
        le=1.0,
        description="Time over which the position limits look ahead, at least one period, s: a longer one brakes "
        "earlier, and is softer against noise in the measured positions.",
    )
    velocity: bool = Field(True, description="Hold the URDF's joint velocity limits.")
    velocity_scale: Annotated[Positive, Field(le=1.0)] = Field(1.0, description="Share of them that may be used.")
    acceleration: Positive = Field(
        200.0,
        le=1.0e5,
        description="Largest joint acceleration, rad/s². With it a joint has to be able to brake before its position "
        "limit: choose what the motors can do.",
    )
    torque_rate: Positive = Field(100.0, le=1.0e5, description="Largest torque change, in effort limits per second.")
    self_collision: SelfCollisionSettings = Field(SelfCollisionSettings(), description="Distances between links.")
    torque_speed: TorqueSpeedSettings = Field(TorqueSpeedSettings(), description="Torque-speed curve of the motors.")


class SafetySettings(_Section):
    """Freshness, and the ladder down."""

    live = ("state_timeout", "activation_ramp", "hold_time", "damping_time", "damping")

    state_timeout: Annotated[Positive, Field(le=1.0)] = Field(
        0.05, description="Oldest joint state or base state that torques may be computed from, s."
    )
    activation_ramp: NonNegative = Field(1.0, le=60.0, description="Time in which the torques ramp in, s.")
    hold_time: NonNegative = Field(0.1, le=1.0, description="Longest time without a solution before damping, s.")
    damping_time: NonNegative = Field(5.0, le=60.0, description="Time of damping before the torques are zero, s.")
    damping: Gain = Field(2.0, description="Joint damping while holding and damping, N·m·s/rad.")


class GuardSettings(_Section):
    """The guard, a process of its own that damps the robot when the controller's commands stop."""

    patience: Annotated[Positive, Field(le=1.0)] = Field(
        0.012, description="How late a command may be, in wall time, before the guard takes over, s."
    )
    damping: Gain = Field(2.0, description="Joint damping, N·m·s/rad.")
    damping_time: NonNegative = Field(5.0, le=60.0, description="Time of damping before the torques are zero, s.")
    torque: Annotated[Positive, Field(le=1.0)] = Field(
        0.2,
        description="Largest damping torque, as a share of the effort limit: a controller that comes back takes over "
        "from at most this.",
    )


class AuditSettings(_Section):
    """The live audit: how large the residuals between model and motion may be before `/diagnostics` warns."""

    time_constant: Positive = Field(0.2, le=10.0, description="Of the filter on the residuals, s.")
    patience: NonNegative = Field(
        0.25, le=10.0, description="How long a residual is too large before there is a warning, s."
    )
    energy: Positive = Field(0.05, le=10.0, description="Largest energy residual, as a share of the joints' power.")
    power: Positive = Field(1.0, le=1.0e5, description="Power of the joints below which it is not measured against, W.")
    force: Positive = Field(
        0.0025,
        le=10.0,
        description="Largest force on the centre of mass that is unaccounted for, as a share of the weight.",
    )
    torque: Positive = Field(
        0.01, le=10.0, description="Largest joint torque that is unaccounted for, as a share of the effort limit."
    )


class _Task(_Section):
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


class _Contact(_Section):
    live = ("enabled", "ramp")

    frame: str = Field(description="A frame of the URDF, fixed to the link that touches.")
    translation: Vector3 = Field([0.0, 0.0, 0.0], description="Origin of the contact in that frame, m.")
    against: str | None = Field(
        None, description="A frame of the URDF, fixed to the link that is touched; none for the world."
    )
    enabled: bool = Field(True, description="Whether the contact is made at activation.")
    damping: Gain = Field(20.0, description="Damping of a residual velocity of the contact, 1/s.")
    ramp: NonNegative = Field(0.2, le=10.0, description="Time in which the contact is loaded or unloaded, s.")


class _PushingContact(_Contact):
    friction: Annotated[Positive, Field(le=2.0)] = Field(0.7, description="Coulomb friction coefficient counted on.")
    min_normal_force: NonNegative = Field(0.0, le=1.0e4, description="Smallest normal force, N.")
    max_normal_force: Annotated[Positive, Field(le=1.0e5)] = Field(description="Largest normal force, N.")


_NORMAL = Field(
    [0.0, 0.0, 1.0],
    description="Normal of the surface, away from it, of any length but zero: in the world's axes, or in those of "
    "`against`.",
)


def _with_a_length(value: list[float]) -> list[float]:
    if not math.hypot(*value) > 1.0e-9:
        raise ValueError("must have a length")
    return value


Direction = Annotated[Vector3, AfterValidator(_with_a_length)]


class SurfaceContact(_PushingContact):
    """A flat rectangle or convex polygon that neither moves nor turns: six forces, exact linear wrench cone."""

    type: Literal["surface"]
    rpy: Vector3 = Field(
        [0.0, 0.0, 0.0],
        description="Orientation of the contact in the frame: roll, pitch, yaw, rad; "
        "its z axis is the normal, away from what is touched.",
    )
    half_length: Length | None = Field(None, description="Half of the rectangle's side along x, m.")
    half_width: Length | None = Field(None, description="Half of the rectangle's side along y, m.")
    vertices: Corners | None = Field(
        None, description="In place of a rectangle: the corners [x, y] of a convex polygon, in any order, up to 12, m."
    )
    max_yaw_moment: Annotated[Positive, Field(le=1.0e4)] | None = Field(
        None, description="Largest moment about the normal, N·m; where it is not given the wrench cone alone bounds it."
    )

    @property
    def corners(self) -> list[list[float]]:
        """Corners of the rectangle or polygon, [x, y] in m."""
        if self.vertices is not None:
            return self.vertices
        x, y = self.half_length or 0.0, self.half_width or 0.0
        return [[x, y], [x, -y], [-x, -y], [-x, y]]

    @model_validator(mode="after")
    def _one_shape(self) -> SurfaceContact:
        given = {key: getattr(self, key) for key in ("half_length", "half_width", "vertices")}
        wanted = {"half_length", "half_width"} if self.vertices is None else {"vertices"}
        for key, value in given.items():
            if (value is not None) != (key in wanted):
                raise ValueError(
                    f"{key} = {reprlib.repr(value)}: a surface takes half_length and half_width, or vertices instead"
                )
        return self


class PointContact(_PushingContact):
    """A ball or point that does not slip: three forces, friction pyramid."""

    type: Literal["point"]
    normal: Direction = _NORMAL
    radius: Length = Field(0.02, description="Radius of the ball, m. The contact's origin is its centre.")


class RollingContact(_PushingContact):
    """A thin wheel that rolls, and slips neither along its way nor to the side: three forces, friction pyramid."""

    type: Literal["rolling"]
    axis: Direction = Field(description="The axle in the frame, of any length but zero.")
    normal: Direction = _NORMAL
    radius: Length = Field(description="Radius of the wheel, m. The contact's origin is its centre.")


_MASK = Field(
    [True] * 6,
    min_length=6,
    max_length=6,
    description="Axes that are held: along x, y, z, about x, y, z. Along the others the link is free.",
)


class FixedContact(_Contact):
    """A link that is held, such as a bolted foot or a hand that grips: up to six forces, both ways, without a cone."""

    type: Literal["fixed"]
    rpy: Vector3 = Field([0.0, 0.0, 0.0], description="Orientation of the contact in the frame: roll, pitch, yaw, rad.")
    mask: list[bool] = _MASK
    max_force: Annotated[Positive, Field(le=1.0e5)] = Field(description="Largest force along each axis held, N.")
    max_moment: Annotated[Positive, Field(le=1.0e5)] | None = Field(
        None, description="Largest moment about each axis held, N·m; required where the mask holds one."
    )

    @model_validator(mode="after")
    def _consistent(self) -> FixedContact:
        if not any(self.mask):
            raise ValueError(f"mask = {self.mask}: it holds no axis")
        if any(self.mask[3:]) and self.max_moment is None:
            raise ValueError("max_moment = None: it is required, as the mask holds a rotation")
        return self


ContactSettings = Annotated[SurfaceContact | PointContact | FixedContact | RollingContact, Field(discriminator="type")]


class LoopSettings(_Section):
    """A closed loop: two frames that a joint outside the URDF's tree holds together, always."""

    frame_a: str = Field(description="A frame of the URDF, fixed to one of the links.")
    frame_b: str = Field(description="A frame of the URDF, fixed to the other link.")
    translation_a: Vector3 = Field([0.0, 0.0, 0.0], description="Origin of the joint in `frame_a`, m.")
    rpy_a: Vector3 = Field([0.0, 0.0, 0.0], description="Orientation of the joint in `frame_a`: roll, pitch, yaw, rad.")
    translation_b: Vector3 = Field([0.0, 0.0, 0.0], description="Origin of the joint in `frame_b`, m.")
    rpy_b: Vector3 = Field([0.0, 0.0, 0.0], description="Orientation of the joint in `frame_b`: roll, pitch, yaw, rad.")
    mask: list[bool] = _MASK
    stiffness: Gain = Field(
        400.0, description="How stiffly what is open closes (Baumgarte), 1/s²; damping is critical."
    )

    @model_validator(mode="after")
    def _consistent(self) -> LoopSettings:
        if not any(self.mask):
            raise ValueError(f"mask = {self.mask}: it holds no axis")
        return self


class MockSettings(_Section):
    """The mock robot."""

    step: Annotated[Positive, Field(le=0.01)] = Field(0.001, description="Step of the physics, s.")
    floor_normal: Direction = Field([0.0, 0.0, 1.0], description="Normal of the floor, of any length but zero.")
    push_duration: Annotated[Positive, Field(le=10.0)] = Field(0.1, description="How long a push lasts, s.")
    command_timeout: Annotated[Positive, Field(le=10.0)] = Field(
        0.1, description="Age of the torques at which the robot damps its joints by itself, s."
    )
    damping: Gain = Field(2.0, description="Joint damping where no torques arrive, N·m·s/rad.")


class Settings(_Section):
    """One robot's whole configuration."""

    robot: RobotSettings
    control: ControlSettings = ControlSettings()
    solver: SolverSettings = SolverSettings()
    limits: LimitSettings = LimitSettings()
    safety: SafetySettings = SafetySettings()
    guard: GuardSettings = GuardSettings()
    audit: AuditSettings = AuditSettings()
    tasks: dict[str, TaskSettings] = Field(min_length=1)
    contacts: dict[str, ContactSettings] = Field(default_factory=dict)
    loops: dict[str, LoopSettings] = Field(default_factory=dict)
    mock: MockSettings = MockSettings()

    @model_validator(mode="after")
    def _distinct(self) -> Settings:
        both = sorted(set(self.contacts) & set(self.loops))
        if both:
            raise ValueError(f"loops: {', '.join(map(repr, both))} is the name of a contact too; take another one")
        return self
