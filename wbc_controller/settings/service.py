"""Settings of the nodes, safety, recorder, mock robot."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from wbc_controller.settings.contacts import Direction
from wbc_controller.settings.values import Name, NonNegative, Positive, Section, Vector3

MOST_CELLS = 2000  # largest number of cells of a block of ground
Damping = Annotated[NonNegative, Field(le=100.0)]  # joint damping, N·m·s/rad
#: Name of a ROS 2 node, with or without its namespace.
NodeName = Annotated[str, Field(pattern=r"^(/?[A-Za-z_][A-Za-z0-9_]*)+$", max_length=255)]
Processor = Annotated[int, Field(ge=0, le=1023)]  # number of a processor in Linux


class RealtimeSettings(Section):
    """Real-time scheduling on Linux (docs/real_time.md). The node does not start without the permissions."""

    scheduling: Literal["other", "fifo", "rr"] = Field(
        "other", description="Scheduling class of all threads; `other`: unchanged."
    )
    priority: int = Field(50, ge=1, le=99, description="Priority for `fifo` and `rr`; larger numbers are more urgent.")
    affinity: list[Processor] = Field(
        default_factory=list, description="Processors of all threads; empty for no change."
    )
    lock_memory: bool = Field(False, description="Lock present and future memory in RAM (mlockall).")
    cpu_dma_latency: int | None = Field(
        None,
        ge=0,
        le=100_000,
        description="Longest wake-up latency of processors, µs (PM QoS); 0 disables idle states.",
    )


class ControlSettings(Section):
    """Control loop."""

    live = ("weight_ramp",)

    rate: Positive = Field(500.0, ge=10.0, le=10000.0, description="Cycles per second.")
    trigger: Literal["timer", "joint_states"] = Field(
        "joint_states", description="timer: absolute deadlines at `rate`. joint_states: one cycle per joint state."
    )
    weight_ramp: NonNegative = Field(0.5, le=60.0, description="Ramp time of weights, gains and limits, s.")
    diagnostics_rate: Positive = Field(
        10.0, le=1000.0, description="Messages per second on /diagnostics; without subscribers at most one."
    )
    markers_rate: NonNegative = Field(
        10.0, le=100.0, description="Messages per second on ~/markers, if subscribed; 0 for none."
    )
    realtime: RealtimeSettings = Field(RealtimeSettings(), description="Real-time scheduling of the process.")


class SolverSettings(Section):
    """Solver and regularization of the quadratic program."""

    name: str = Field(
        "daqp", description="daqp, osqp or proxqp (persistent, warm-started), or any installed solver of qpsolvers."
    )
    regularization_acceleration: Positive = Field(
        1.0e-5,
        le=1.0,
        description="Weight of ½(‖q̈‖² + ‖ḣ_G/m‖²), joint accelerations and centroidal momentum rate; (rad/s²)⁻², "
        "(m/s²)⁻².",
    )
    regularization_force: Positive = Field(
        1.0e-6, le=1.0, description="Weight of ½‖f‖², N⁻²; moments of a sole are converted to forces at its corners."
    )


class SafetySettings(Section):
    """Freshness and plausibility of inputs, activation, holding and damping (docs/safety.md)."""

    state_timeout: Positive = Field(0.05, le=1.0, description="Largest age of a joint state or base state, s.")
    synchronized_clocks: bool = Field(
        False,
        description="True if robot and computer have synchronized clocks (PTP, chrony) or a simulator's clock "
        "(`use_sim_time`): ages then include a constant latency.",
    )
    clock_tolerance: Positive = Field(
        0.01,
        le=0.5,
        description="With `synchronized_clocks`: largest lead of a timestamp over the computer's clock, s; with a "
        "simulator at least the interval of its clock messages.",
    )
    activation_ramp: NonNegative = Field(
        0.2, le=60.0, description="Ramp time of the torques, s; an unsupported robot falls meanwhile."
    )
    hold_time: NonNegative = Field(
        0.1, le=1.0, description="Longest time without a solution within `hold_window`, s; then damping mode."
    )
    hold_window: NonNegative = Field(
        1.0, le=60.0, description="Window for `hold_time`, s; 0 counts uninterrupted time only."
    )
    relax_time: NonNegative = Field(
        0.5, le=60.0, description="Longest time with relaxed constraints within `relax_window`, s; then damping mode."
    )
    relax_window: Positive = Field(2.0, le=600.0, description="Window for `relax_time`, s; longer than `relax_time`.")
    damping_time: NonNegative = Field(5.0, le=60.0, description="Duration of damping before zero torque, s.")
    damping: Damping = Field(
        2.0,
        description="Joint damping while holding and damping, N·m·s/rad; reduced at light joints for stability at this "
        "rate.",
    )
    bring_up_time: NonNegative = Field(
        5.0,
        le=3600.0,
        description="First active time in which unexplained motion stops the robot without damping, s; 0 for never.",
    )
    bring_up_speed: Positive = Field(
        5.0,
        le=1.0e3,
        description="Largest unexplained joint speed during `bring_up_time`, rad/s; times 3 for joints with an active "
        "contact, times 1/5 in m/s for prismatic joints.",
    )
    max_tilt: Positive = Field(
        1.0,
        le=3.2,
        description="Tilt of a floating base relative to activation that counts as a fall, rad; 3.2 for none.",
    )
    min_height: NonNegative = Field(
        0.4,
        le=1.0,
        description="Height of a floating base above the lowest limb end that counts as a fall, as a share of that "
        "at activation; 0 for none.",
    )
    max_magnitude: Positive = Field(
        1.0e6, le=1.0e9, description="Largest plausible joint position or base coordinate, rad or m."
    )
    max_joint_speed: Positive = Field(
        5.0,
        ge=1.0,
        le=100.0,
        description="Largest plausible joint velocity, in multiples of the URDF's velocity limit.",
    )
    max_base_speed: Positive = Field(20.0, le=1.0e3, description="Largest plausible base velocity along an axis, m/s.")
    max_base_turn: Positive = Field(
        50.0, le=1.0e3, description="Largest plausible angular base velocity about an axis, rad/s."
    )
    joint_mismatch: Positive = Field(
        0.2,
        le=100.0,
        description="Largest plausible difference between joint displacement and integrated joint velocity over 0.2 s, "
        "rad.",
    )
    base_mismatch: Positive = Field(
        0.1,
        le=100.0,
        description="The same for the base position along an axis, m; larger jumps of the odometry are a fault.",
    )
    base_turn_mismatch: Positive = Field(
        0.2, le=10.0, description="The same for the base orientation about an axis, rad."
    )
    frozen_motion: Positive = Field(
        0.03,
        le=100.0,
        description="Largest integrated velocity over 0.2 s of a joint with bitwise constant position, rad.",
    )
    frozen_time: Positive = Field(
        0.1,
        le=60.0,
        description="Longest repetition of equal joint or base states at non-zero velocity, s; at least "
        "`state_timeout`.",
    )

    torque_publishers: list[NodeName] = Field(
        ["guard"],
        description="Other nodes that may publish torques: names in the controller's namespace, or absolute names.",
    )

    @model_validator(mode="after")
    def _ordered_windows(self) -> "SafetySettings":
        if not (self.relax_time < self.relax_window):
            raise ValueError(f"relax_window = {self.relax_window}: must be above relax_time = {self.relax_time}")
        return self


class RecorderSettings(Section):
    """Flight recorder: buffer of the last cycles, written to a file on a fault or on request (docs/recording.md)."""

    seconds: NonNegative = Field(
        10.0, le=600.0, description="Length of the buffer, s; 0 for none: only `wbc run --record` records."
    )
    folder: str = Field(
        "", description="Folder; empty for `wbc_controller` in `$XDG_STATE_HOME`, by default ~/.local/state."
    )
    files: int = Field(10, ge=1, le=1000, description="Number of files kept per robot; the oldest are removed.")


class GuardSettings(Section):
    """Guard: separate process that damps the robot when the controller's commands stop (docs/safety.md)."""

    patience: Positive = Field(
        0.012, le=1.0, description="Delay of a command, in wall time, after which the guard takes over, s."
    )
    damping: Damping = Field(2.0, description="Joint damping, N·m·s/rad; reduced at light joints, as `safety.damping`.")
    damping_time: NonNegative = Field(5.0, le=60.0, description="Duration of damping before zero torque, s.")
    torque: Positive = Field(
        0.2,
        le=1.0,
        description="Largest damping torque, and torque at the return of a controller, as a share of the effort limit.",
    )


class AuditSettings(Section):
    """Model audit: thresholds of the residuals for warnings on `/diagnostics`."""

    time_constant: Positive = Field(0.2, le=10.0, description="Time constant of the residual filter, s.")
    patience: NonNegative = Field(0.4, le=10.0, description="Duration of a too large residual before a warning, s.")
    energy: Positive = Field(0.05, le=10.0, description="Largest energy residual, as a share of the joint power.")
    power: Positive = Field(1.0, le=1.0e5, description="Smallest joint power for the energy residual, W.")
    force: Positive = Field(
        0.0025, le=10.0, description="Largest unexplained force on the centre of mass, as a share of the weight."
    )
    torque: Positive = Field(
        0.01, le=10.0, description="Largest unexplained joint torque, as a share of the effort limit."
    )


SensorQuality = Literal["ideal", "good", "cheap"]  # quality of the mock robot's sensors and motors (docs/estimation.md)


class TerrainSettings(Section):
    """Block on the floor: a step, slope, mat, or uneven cells."""

    position: Vector3 = Field(description="Middle of the upper edge at -x, m, the centre of the rotation `rpy`.")
    size: Annotated[list[Annotated[Positive, Field(le=200.0)]], Field(min_length=3, max_length=3)] = Field(
        description="Along x, along y, and thickness, m."
    )
    rpy: Vector3 = Field([0.0, 0.0, 0.0], description="Roll, pitch (above 0: descends along x) and yaw, rad.")
    friction: NonNegative | None = Field(
        None, le=2.0, description="Coulomb friction coefficient; default `mock.friction`."
    )
    stiffness: Positive | None = Field(
        None, le=1.0e7, description="Stiffness at each contact point, N/m; rigid by default."
    )
    damping: Positive = Field(500.0, le=1.0e6, description="Damping of soft ground, also per point, N·s/m.")
    unevenness: NonNegative = Field(0.0, le=1.0, description="Largest random change of a cell's height, m.")
    cell: Positive = Field(0.3, description="Side of a square cell, m.")
    seed: int = Field(0, ge=0, le=2**31 - 1, description="Random seed of the heights.")

    @property
    def cells(self) -> tuple[int, int]:
        """Number of cells along x and y; one without unevenness."""
        if self.unevenness == 0.0:
            return 1, 1
        return max(1, round(self.size[0] / self.cell)), max(1, round(self.size[1] / self.cell))

    @model_validator(mode="after")
    def _few_cells(self) -> "TerrainSettings":
        count = self.cells[0] * self.cells[1]
        if count > MOST_CELLS:
            raise ValueError(f"cell = {self.cell}: the block has {count} cells; at most {MOST_CELLS} are allowed")
        return self


class MockSettings(Section):
    """Mock robot."""

    step: Positive = Field(0.001, le=0.01, description="Time step of the simulation, s.")
    floor_normal: Direction = Field([0.0, 0.0, 1.0], description="Normal of the floor; any length.")
    friction: NonNegative = Field(0.7, le=2.0, description="Coulomb friction coefficient of the floor.")
    terrain: dict[Name, TerrainSettings] = Field(default_factory=dict, description="Blocks of ground.")
    push_duration: Positive = Field(0.1, le=10.0, description="Duration of a push, s.")
    command_timeout: Positive = Field(
        0.1, le=10.0, description="Age of the torques after which the joints are damped, s."
    )
    damping: Damping = Field(2.0, description="Joint damping without torque commands, N·m·s/rad.")
    joint_friction: NonNegative = Field(0.0, le=1.0e3, description="Dry friction of each joint in the simulation, N·m.")
    joint_viscosity: NonNegative = Field(0.0, le=1.0e3, description="Viscous friction, N·m·s/rad.")
    sensors: SensorQuality = Field(
        "ideal", description="Quality of IMU, encoders and motors (docs/estimation.md). Odometry is exact."
    )
    sensor_seed: int = Field(0, ge=0, le=2**31 - 1, description="Random seed of the sensors.")
    pose_rate: NonNegative = Field(0.0, le=1.0e3, description="Rate of the topic `pose`, Hz; 0 for none.")
    pose_delay: NonNegative = Field(0.0, le=10.0, description="Latency of these poses, s.")
    pose_noise: NonNegative = Field(0.0, le=10.0, description="Standard deviation of their position, m.")
    pose_turn_noise: NonNegative = Field(0.0, le=3.0, description="Standard deviation of their orientation, rad.")
    joint_velocity: bool = Field(True, description="Joint states contain velocities.")
