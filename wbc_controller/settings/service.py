"""Settings of the nodes, safety, recorder, mock robot."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from wbc_controller.settings.contacts import Direction
from wbc_controller.settings.values import Name, NonNegative, Positive, Section, Vector3, key, ordered

MOST_CELLS = 2000  # largest number of cells of a block of ground
Damping = Annotated[NonNegative, Field(le=100.0)]  # joint damping, N·m·s/rad
#: Name of a ROS 2 node, with or without its namespace.
NodeName = Annotated[str, Field(pattern=r"^(/?[A-Za-z_][A-Za-z0-9_]*)+$", max_length=255)]
Processor = Annotated[int, Field(ge=0, le=1023)]  # number of a processor in Linux


class RealtimeSettings(Section):
    """Real-time scheduling on Linux (docs/real_time.md). The node does not start without the permissions."""

    scheduling: Literal["other", "fifo", "rr"] = key("other", "Scheduling class of all threads; `other`: unchanged.")
    priority: int = key(50, "Priority for `fifo` and `rr`; larger numbers are more urgent.", ge=1, le=99)
    affinity: list[Processor] = key([], "Processors of all threads; empty for no change.")
    lock_memory: bool = key(False, "Lock present and future memory in RAM (mlockall).")
    cpu_dma_latency: int | None = key(
        None, "Longest wake-up latency of processors, µs (PM QoS); 0 disables idle states.", ge=0, le=100_000
    )


class ControlSettings(Section):
    """Control loop."""

    live = ("weight_ramp",)

    rate: Positive = key(500.0, "Cycles per second.", ge=10.0, le=10000.0)
    trigger: Literal["timer", "joint_states"] = key(
        "joint_states", "timer: absolute deadlines at `rate`. joint_states: one cycle per joint state."
    )
    weight_ramp: NonNegative = key(0.5, "Ramp time of weights, gains and limits, s.", le=60.0)
    diagnostics_rate: Positive = key(
        10.0, "Messages per second on /diagnostics; without subscribers at most one.", le=1000.0
    )
    markers_rate: NonNegative = key(10.0, "Messages per second on ~/markers, if subscribed; 0 for none.", le=100.0)
    realtime: RealtimeSettings = key(RealtimeSettings(), "Real-time scheduling of the process.")


class SolverSettings(Section):
    """Solver and regularization of the quadratic program."""

    name: str = key("daqp", "daqp, osqp or proxqp (persistent, warm-started), or any installed solver of qpsolvers.")
    regularization_acceleration: Positive = key(
        1.0e-5,
        "Weight of ½(‖q̈‖² + ‖ḣ_G/m‖²), joint accelerations and centroidal momentum rate; (rad/s²)⁻², (m/s²)⁻².",
        le=1.0,
    )
    regularization_force: Positive = key(
        1.0e-6, "Weight of ½‖f‖², N⁻²; moments of a sole are converted to forces at its corners.", le=1.0
    )


class SafetySettings(Section):
    """Freshness and plausibility of inputs, activation, holding and damping (docs/safety.md)."""

    state_timeout: Positive = key(0.05, "Largest age of a joint state or base state, s.", le=1.0)
    synchronized_clocks: bool = key(
        False,
        "True if robot and computer have synchronized clocks (PTP, chrony) or a simulator's clock "
        "(`use_sim_time`): ages then include a constant latency.",
    )
    clock_tolerance: Positive = key(
        0.01,
        "With `synchronized_clocks`: largest lead of a timestamp over the computer's clock, s; with a "
        "simulator at least the interval of its clock messages.",
        le=0.5,
    )
    activation_ramp: NonNegative = key(
        0.2, "Ramp time of the torques, s; an unsupported robot falls meanwhile.", le=60.0
    )
    hold_time: NonNegative = key(
        0.1, "Longest time without a solution within `hold_window`, s; then damping mode.", le=1.0
    )
    hold_window: NonNegative = key(1.0, "Window for `hold_time`, s; 0 counts uninterrupted time only.", le=60.0)
    relax_time: NonNegative = key(
        0.5, "Longest time with relaxed constraints within `relax_window`, s; then damping mode.", le=60.0
    )
    relax_window: Positive = key(2.0, "Window for `relax_time`, s; longer than `relax_time`.", le=600.0)
    damping_time: NonNegative = key(5.0, "Duration of damping before zero torque, s.", le=60.0)
    damping: Damping = key(
        2.0, "Joint damping while holding and damping, N·m·s/rad; reduced at light joints for stability at this rate."
    )
    bring_up_time: NonNegative = key(
        5.0, "First active time in which unexplained motion stops the robot without damping, s; 0 for never.", le=3600.0
    )
    bring_up_speed: Positive = key(
        5.0,
        "Largest unexplained joint speed during `bring_up_time`, rad/s; times 3 for joints with an active "
        "contact, times 1/5 in m/s for prismatic joints.",
        le=1.0e3,
    )
    max_tilt: Positive = key(
        1.0, "Tilt of a floating base relative to activation that counts as a fall, rad; 3.2 for none.", le=3.2
    )
    min_height: NonNegative = key(
        0.4,
        "Height of a floating base above the lowest limb end that counts as a fall, as a share of that at "
        "activation; 0 for none.",
        le=1.0,
    )
    max_magnitude: Positive = key(1.0e6, "Largest plausible joint position or base coordinate, rad or m.", le=1.0e9)
    max_joint_speed: Positive = key(
        5.0, "Largest plausible joint velocity, in multiples of the URDF's velocity limit.", ge=1.0, le=100.0
    )
    max_base_speed: Positive = key(20.0, "Largest plausible base velocity along an axis, m/s.", le=1.0e3)
    max_base_turn: Positive = key(50.0, "Largest plausible angular base velocity about an axis, rad/s.", le=1.0e3)
    joint_mismatch: Positive = key(
        0.2,
        "Largest plausible difference between joint displacement and integrated joint velocity over 0.2 s, rad.",
        le=100.0,
    )
    base_mismatch: Positive = key(
        0.1, "The same for the base position along an axis, m; larger jumps of the odometry are a fault.", le=100.0
    )
    base_turn_mismatch: Positive = key(0.2, "The same for the base orientation about an axis, rad.", le=10.0)
    frozen_motion: Positive = key(
        0.03, "Largest integrated velocity over 0.2 s of a joint with bitwise constant position, rad.", le=100.0
    )
    frozen_time: Positive = key(
        0.1,
        "Longest repetition of equal joint or base states at non-zero velocity, s; at least `state_timeout`.",
        le=60.0,
    )

    torque_publishers: list[NodeName] = key(
        ["guard"], "Other nodes that may publish torques: names in the controller's namespace, or absolute names."
    )

    _ordered_windows = ordered("relax_time", "relax_window")


class RecorderSettings(Section):
    """Flight recorder: buffer of the last cycles, written to a file on a fault or on request (docs/recording.md)."""

    seconds: NonNegative = key(10.0, "Length of the buffer, s; 0 for none: only `wbc run --record` records.", le=600.0)
    folder: str = key("", "Folder; empty for `wbc_controller` in `$XDG_STATE_HOME`, by default ~/.local/state.")
    files: int = key(10, "Number of files kept per robot; the oldest are removed.", ge=1, le=1000)


class GuardSettings(Section):
    """Guard: separate process that damps the robot when the controller's commands stop (docs/safety.md)."""

    patience: Positive = key(0.012, "Delay of a command, in wall time, after which the guard takes over, s.", le=1.0)
    damping: Damping = key(2.0, "Joint damping, N·m·s/rad; reduced at light joints, as `safety.damping`.")
    damping_time: NonNegative = key(5.0, "Duration of damping before zero torque, s.", le=60.0)
    torque: Positive = key(
        0.2, "Largest damping torque, and torque at the return of a controller, as a share of the effort limit.", le=1.0
    )


class AuditSettings(Section):
    """Model audit: thresholds of the residuals for warnings on `/diagnostics`."""

    time_constant: Positive = key(0.2, "Time constant of the residual filter, s.", le=10.0)
    patience: NonNegative = key(0.4, "Duration of a too large residual before a warning, s.", le=10.0)
    energy: Positive = key(0.05, "Largest energy residual, as a share of the joint power.", le=10.0)
    power: Positive = key(1.0, "Smallest joint power for the energy residual, W.", le=1.0e5)
    force: Positive = key(0.0025, "Largest unexplained force on the centre of mass, as a share of the weight.", le=10.0)
    torque: Positive = key(0.01, "Largest unexplained joint torque, as a share of the effort limit.", le=10.0)


SensorQuality = Literal["ideal", "good", "cheap"]  # quality of the mock robot's sensors and motors (docs/estimation.md)


class TerrainSettings(Section):
    """Block on the floor: a step, slope, mat, or uneven cells."""

    position: Vector3 = Field(description="Middle of the upper edge at -x, m, the centre of the rotation `rpy`.")
    size: Annotated[list[Annotated[Positive, Field(le=200.0)]], Field(min_length=3, max_length=3)] = Field(
        description="Along x, along y, and thickness, m."
    )
    rpy: Vector3 = key([0.0, 0.0, 0.0], "Roll, pitch (above 0: descends along x) and yaw, rad.")
    friction: NonNegative | None = key(None, "Coulomb friction coefficient; default `mock.friction`.", le=2.0)
    stiffness: Positive | None = key(None, "Stiffness at each contact point, N/m; rigid by default.", le=1.0e7)
    damping: Positive = key(500.0, "Damping of soft ground, also per point, N·s/m.", le=1.0e6)
    unevenness: NonNegative = key(0.0, "Largest random change of a cell's height, m.", le=1.0)
    cell: Positive = key(0.3, "Side of a square cell, m.")
    seed: int = key(0, "Random seed of the heights.", ge=0, le=2**31 - 1)

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

    step: Positive = key(0.001, "Time step of the simulation, s.", le=0.01)
    floor_normal: Direction = key([0.0, 0.0, 1.0], "Normal of the floor; any length.")
    friction: NonNegative = key(0.7, "Coulomb friction coefficient of the floor.", le=2.0)
    terrain: dict[Name, TerrainSettings] = key({}, "Blocks of ground.")
    push_duration: Positive = key(0.1, "Duration of a push, s.", le=10.0)
    command_timeout: Positive = key(0.1, "Age of the torques after which the joints are damped, s.", le=10.0)
    damping: Damping = key(2.0, "Joint damping without torque commands, N·m·s/rad.")
    joint_friction: NonNegative = key(0.0, "Dry friction of each joint in the simulation, N·m.", le=1.0e3)
    joint_viscosity: NonNegative = key(0.0, "Viscous friction, N·m·s/rad.", le=1.0e3)
    sensors: SensorQuality = key(
        "ideal", "Quality of IMU, encoders and motors (docs/estimation.md). Odometry is exact."
    )
    sensor_seed: int = key(0, "Random seed of the sensors.", ge=0, le=2**31 - 1)
    pose_rate: NonNegative = key(0.0, "Rate of the topic `pose`, Hz; 0 for none.", le=1.0e3)
    pose_delay: NonNegative = key(0.0, "Latency of these poses, s.", le=10.0)
    pose_noise: NonNegative = key(0.0, "Standard deviation of their position, m.", le=10.0)
    pose_turn_noise: NonNegative = key(0.0, "Standard deviation of their orientation, rad.", le=3.0)
    joint_velocity: bool = key(True, "Joint states contain velocities.")
