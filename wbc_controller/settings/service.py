"""Settings of the service around the quadratic program: loop, solver, safety, guard, audit, mock robot."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from wbc_controller.settings.contacts import Direction
from wbc_controller.settings.values import NonNegative, Positive, Section

#: Joint damping, N·m·s/rad: a motor of a humanoid's leg has a fraction of it; beyond, a mistaken unit is more likely.
Damping = Annotated[NonNegative, Field(le=100.0)]

#: Name of a ROS 2 node, with or without its namespace.
NodeName = Annotated[str, Field(pattern=r"^(/?[A-Za-z_][A-Za-z0-9_]*)+$", max_length=255)]


#: Number of a processor, as Linux counts them.
Processor = Annotated[int, Field(ge=0, le=1023)]


class RealtimeSettings(Section):
    """Real time for the controller's process, on Linux: docs/real_time.md.

    Off by default. What the system refuses ends the node at the start, with what to set there. Not live.
    """

    scheduling: Literal["other", "fifo", "rr"] = Field(
        "other",
        description="Scheduling class of all threads: `fifo` is SCHED_FIFO, `rr` is SCHED_RR, and `other` leaves that "
        "with which the process was started.",
    )
    priority: Annotated[int, Field(ge=1, le=99)] = Field(
        50, description="Priority for `fifo` and `rr`; a larger number goes first."
    )
    affinity: list[Processor] = Field(
        default_factory=list,
        description="Processors on which all threads run; empty leaves those with which the process was started.",
    )
    lock_memory: bool = Field(
        False, description="Keep all memory of the process in RAM, what it will allocate too (mlockall)."
    )
    cpu_dma_latency: Annotated[int, Field(ge=0, le=100_000)] | None = Field(
        None,
        description="Longest time that a processor may take to wake from an idle state, µs (PM QoS), while the process "
        "runs; 0 keeps all processors of the computer awake. Unset, the system decides.",
    )


class ControlSettings(Section):
    """The control loop."""

    live = ("weight_ramp",)

    rate: Annotated[Positive, Field(ge=10.0, le=10000.0)] = Field(500.0, description="Cycles per second.")
    trigger: Literal["timer", "joint_states"] = Field(
        "joint_states", description="timer: absolute deadlines at `rate`. joint_states: one cycle per joint state."
    )
    weight_ramp: NonNegative = Field(0.5, le=60.0, description="Time of the ramp to new weights, gains and limits, s.")
    diagnostics_rate: Annotated[Positive, Field(le=1000.0)] = Field(
        10.0, description="Messages per second on /diagnostics, while somebody reads them; otherwise at most one."
    )
    markers_rate: NonNegative = Field(
        10.0,
        le=100.0,
        description=(
            "Most messages per second on ~/markers, made after the torques are sent while somebody reads it; 0 for "
            "none."
        ),
    )
    realtime: RealtimeSettings = Field(RealtimeSettings(), description="Real-time scheduling of the process.")


class SolverSettings(Section):
    """The solver of the quadratic program."""

    name: str = Field(
        "daqp",
        description="daqp, osqp and proxqp are warm-started; any other installed "
        "solver of qpsolvers can be named too, and is called through qpsolvers.",
    )
    regularization_acceleration: Positive = Field(
        1.0e-5,
        le=1.0,
        description="Weight of ½(‖q̈‖² + ‖ḣ_G/m‖²): joint accelerations, and the rate of change of the "
        "momentum about the centre of mass divided by the mass; (rad/s²)⁻², (m/s²)⁻².",
    )
    regularization_force: Positive = Field(
        1.0e-6,
        le=1.0,
        description="Weight of ½‖f‖², N⁻²; moments at a sole count as the forces at its corners that make them up.",
    )


class SafetySettings(Section):
    """Freshness and plausibility of the inputs, activation, and the way down to zero torque: none of it is live."""

    state_timeout: Annotated[Positive, Field(le=1.0)] = Field(
        0.05, description="Largest age of a joint state or base state from which torques are computed, s."
    )
    synchronized_clocks: bool = Field(
        False,
        description="The robot's clock and this computer's are kept synchronized (PTP, chrony), or are both that of a "
        "simulator (`use_sim_time`): the age of a state is then the time since its stamp, and a latency that is "
        "constant counts too. Otherwise the offset between the clocks is learned, and with it the shortest latency.",
    )
    clock_tolerance: Annotated[Positive, Field(le=0.5)] = Field(
        0.01,
        description="With `synchronized_clocks`: how far a stamp may be ahead of this computer's clock, s; by as "
        "much an age may be too small. With a simulator it is at least the time between two messages of its clock.",
    )
    activation_ramp: NonNegative = Field(
        0.2,
        le=60.0,
        description="Time in which the torques ramp up, s. What only the brakes of its joints have held falls in that "
        "time, so it is short; a robot whose drives hold it until then bears a longer one.",
    )
    hold_time: NonNegative = Field(
        0.1, le=1.0, description="Longest time without a solution within `hold_window` before damping mode, s."
    )
    hold_window: NonNegative = Field(
        1.0,
        le=60.0,
        description="Window over which the time without a solution adds up, s; 0 counts only without interruption.",
    )
    relax_time: NonNegative = Field(
        0.5, le=60.0, description="Longest time with relaxed constraints within `relax_window` before damping mode, s."
    )
    relax_window: Annotated[Positive, Field(le=600.0)] = Field(
        2.0, description="Window over which the time with relaxed constraints adds up, s; longer than `relax_time`."
    )
    damping_time: NonNegative = Field(5.0, le=60.0, description="Time of damping before the torques are zero, s.")
    damping: Damping = Field(
        2.0,
        description="Joint damping while holding and damping, N·m·s/rad; less at light joints if a posture within the "
        "limits makes it unstable at this rate.",
    )
    bring_up_time: NonNegative = Field(
        5.0,
        le=3600.0,
        description="Time of active control after the start of the process in which motion that the torques do not "
        "explain stops the robot without damping, s: torques may reach other joints. 0 for never.",
    )
    bring_up_speed: Annotated[Positive, Field(le=1.0e3)] = Field(
        5.0,
        description="Largest unexplained speed of a joint in that time, rad/s; three times as much if it carries an "
        "active contact, and a fifth in m/s if it is prismatic.",
    )
    max_tilt: Annotated[Positive, Field(le=3.2)] = Field(
        1.0,
        description="Angle between the base's upward direction and that at the activation, rad, above which a robot "
        "with a floating base has fallen; 3.2 for none.",
    )
    min_height: NonNegative = Field(
        0.4,
        le=1.0,
        description="Height of the base above the lowest end of a limb, as a share of that at the activation, below "
        "which a robot with a floating base has fallen; 0 for none.",
    )
    max_magnitude: Annotated[Positive, Field(le=1.0e9)] = Field(
        1.0e6, description="Largest plausible joint position or base coordinate, rad or m."
    )
    max_joint_speed: Annotated[Positive, Field(ge=1.0, le=100.0)] = Field(
        5.0, description="Largest plausible joint velocity, as a multiple of the URDF's velocity limit."
    )
    max_base_speed: Annotated[Positive, Field(le=1.0e3)] = Field(
        20.0, description="Largest plausible velocity of the base along an axis, m/s."
    )
    max_base_turn: Annotated[Positive, Field(le=1.0e3)] = Field(
        50.0, description="Largest plausible angular velocity of the base about an axis, rad/s."
    )
    joint_mismatch: Annotated[Positive, Field(le=100.0)] = Field(
        0.2,
        description="Largest plausible difference between the change of a joint position and its velocity, integrated "
        "over the last 0.2 s, rad.",
    )
    base_mismatch: Annotated[Positive, Field(le=100.0)] = Field(
        0.1, description="Likewise of the base's position along an axis, m: a larger jump of the odometry is a fault."
    )
    base_turn_mismatch: Annotated[Positive, Field(le=10.0)] = Field(
        0.2, description="Likewise of the base's orientation about an axis, rad."
    )
    frozen_motion: Annotated[Positive, Field(le=100.0)] = Field(
        0.03,
        description="Largest motion that a joint's velocity may tell, integrated over the last 0.2 s, while its "
        "position repeats bit for bit, rad.",
    )
    frozen_time: Annotated[Positive, Field(le=60.0)] = Field(
        0.1,
        description="Longest time for which the joint states, or the base's pose and twist, may repeat bit for bit at "
        "velocities that are not zero, s; not less than `state_timeout`.",
    )

    torque_publishers: list[NodeName] = Field(
        ["guard"],
        description="Nodes beside the controller that may publish torques, as the guard does: names in the "
        "controller's namespace, or with a slash at the start. While any other node publishes torques, `activate` is "
        "refused.",
    )

    @model_validator(mode="after")
    def _lasts(self) -> SafetySettings:
        if not (self.relax_time < self.relax_window):
            raise ValueError(f"relax_window = {self.relax_window}: must be above relax_time = {self.relax_time}")
        return self


class RecorderSettings(Section):
    """The flight recorder: what it keeps in memory, and writes to a file on a fault or on request."""

    seconds: NonNegative = Field(
        10.0, le=600.0, description="How much is kept, s; 0 for nothing, so that only `wbc run --record` writes a file."
    )
    folder: str = Field(
        "",
        description="Folder of the files; empty for `wbc_controller` in `$XDG_STATE_HOME`, by default ~/.local/state.",
    )
    files: int = Field(10, ge=1, le=1000, description="Most files of one robot in the folder; the oldest are removed.")


class GuardSettings(Section):
    """The guard, a separate process that damps the robot when the controller's commands stop."""

    patience: Annotated[Positive, Field(le=1.0)] = Field(
        0.012, description="Lateness of a command, in wall time, at which the guard takes over, s."
    )
    damping: Damping = Field(2.0, description="Joint damping, N·m·s/rad; less at light joints, as `safety.damping`.")
    damping_time: NonNegative = Field(5.0, le=60.0, description="Time of damping before the torques are zero, s.")
    torque: Annotated[Positive, Field(le=1.0)] = Field(
        0.2,
        description="Largest damping torque, as a share of the effort limit; also the largest torque from which a "
        "returning controller takes over.",
    )


class AuditSettings(Section):
    """The live audit: limits on the residuals between model and motion, above which `/diagnostics` warns."""

    time_constant: Positive = Field(0.2, le=10.0, description="Time constant of the filter on the residuals, s.")
    patience: NonNegative = Field(
        0.4, le=10.0, description="Time for which a residual must be too large before there is a warning, s."
    )
    energy: Positive = Field(0.05, le=10.0, description="Largest energy residual, as a share of the joint power.")
    power: Positive = Field(1.0, le=1.0e5, description="Smallest joint power for that comparison, W.")
    force: Positive = Field(
        0.0025, le=10.0, description="Largest unexplained force on the centre of mass, as a share of the weight."
    )
    torque: Positive = Field(
        0.01, le=10.0, description="Largest unexplained joint torque, as a share of the effort limit."
    )


#: Quality of the mock robot's sensors and motors.
SensorQuality = Literal["ideal", "good", "cheap"]


class MockSettings(Section):
    """The mock robot."""

    step: Annotated[Positive, Field(le=0.01)] = Field(0.001, description="Time step of the simulation, s.")
    floor_normal: Direction = Field([0.0, 0.0, 1.0], description="Normal of the floor, of any non-zero length.")
    friction: Annotated[NonNegative, Field(le=2.0)] = Field(
        0.7, description="Coulomb friction coefficient of the floor, whatever the contacts assume."
    )
    push_duration: Annotated[Positive, Field(le=10.0)] = Field(0.1, description="Duration of a push, s.")
    command_timeout: Annotated[Positive, Field(le=10.0)] = Field(
        0.1, description="Age of the torques at which the robot damps its joints by itself, s."
    )
    damping: Damping = Field(2.0, description="Joint damping while no torques arrive, N·m·s/rad.")
    joint_friction: NonNegative = Field(
        0.0, le=1.0e3, description="Dry friction of each of its joints, which the controller's model lacks, N·m."
    )
    joint_viscosity: NonNegative = Field(
        0.0, le=1.0e3, description="Viscous friction of each of its joints, likewise, N·m·s/rad."
    )
    sensors: SensorQuality = Field(
        "ideal",
        description="Quality of its IMU, encoders and motors: ideal ones tell the truth, the others have the noise, "
        "biases, resolution and errors of parts that robots carry (docs/estimation.md). Odometry stays true.",
    )
    sensor_seed: int = Field(0, ge=0, le=2**31 - 1, description="Of the noise, biases and errors of the sensors.")
    pose_rate: NonNegative = Field(
        0.0, le=1.0e3, description="Rate of absolute poses on the topic `pose`, Hz; 0 for none."
    )
    pose_delay: NonNegative = Field(0.0, le=10.0, description="Time by which these poses come late, s.")
    pose_noise: NonNegative = Field(0.0, le=10.0, description="Standard deviation of their position, m.")
    pose_turn_noise: NonNegative = Field(0.0, le=3.0, description="Standard deviation of their orientation, rad.")
    joint_velocity: bool = Field(
        True,
        description="Whether its joint states have velocities; otherwise the controller needs "
        "`estimation.joint_velocity` = differentiated.",
    )
