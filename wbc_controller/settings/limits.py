"""Settings of the limits."""

from pydantic import Field

from wbc_controller.settings.values import NonNegative, Positive, Section, key, ordered


class ActuatorTorqueSpeed(Section):
    """Torque-speed curve of one actuator."""

    corner: Positive = Field(le=1.0e4, description="Highest speed with the full effort limit, rad/s.")
    no_load: Positive = Field(le=1.0e4, description="Speed of zero torque, rad/s.")

    _ordered_speeds = ordered("corner", "no_load")


class TorqueSpeedSettings(Section):
    """Torque-speed curve of the motors: from `corner` to `no_load` the torque in the direction of motion decreases."""

    enabled: bool = key(False, "Enforce the torque-speed curve.")
    corner: Positive = key(
        0.5, "Highest speed with the full effort limit, as a share of the URDF's velocity limit.", le=10.0
    )
    no_load: Positive = key(1.0, "Speed of zero torque, as a share of the URDF's velocity limit.", le=10.0)
    actuators: dict[str, ActuatorTorqueSpeed] = key(
        {}, "Curves of single actuators; required for actuators in `robot.transmission`."
    )

    _ordered_speeds = ordered("corner", "no_load")


class SelfCollisionSettings(Section):
    """Self-collision avoidance (docs/limits.md)."""

    enabled: bool = key(False, "Keep a distance between links.")
    margin: Positive = key(0.02, "Smallest distance, m.", le=0.5)
    acceleration: Positive = key(
        20.0, "Deceleration of approaching links, m/s². The motors must reach it with a stretched arm.", le=1.0e3
    )
    horizon: NonNegative = key(0.02, "Look-ahead time, s, as `position_horizon`.", le=1.0)
    max_pairs: int = key(12, "Number of constrained pairs per cycle: the most urgent ones.", ge=1, le=200)
    srdf: str = key("", "Path of an SRDF, as `robot.urdf`; its disabled pairs are excluded.")
    visual: list[str] = key([], "Links with visual elements used as collision elements.")
    pairs: list[str] = key(
        [],
        "Pairs `<link>/<link>`. Empty: all except links connected by one or two joints, disabled pairs of "
        "the SRDF, and pairs nearer than `margin` in `robot.posture`.",
    )


class LimitSettings(Section):
    """Limits in the quadratic program. Torque limits always apply."""

    live = ("position_margin", "position_horizon", "velocity_scale", "acceleration")
    # Ranges in which the shipped robots sway and squat without relaxed or violated limits.
    live_ranges = {  # noqa: RUF012 - declared as a class variable above
        "position_margin": (0.0, 0.2),
        "velocity_scale": (0.15, 1.0),
        "acceleration": (20.0, None),
    }

    position: bool = key(True, "Enforce the URDF's joint position limits.")
    position_margin: NonNegative = key(0.02, "Distance to the position limits, rad.", le=1.0)
    position_horizon: NonNegative = key(
        0.02,
        "Look-ahead time of position and velocity limits, s, at least one period. Longer horizons brake "
        "earlier and are less sensitive to noise.",
        le=1.0,
    )
    velocity: bool = key(True, "Enforce the URDF's joint velocity limits.")
    velocity_scale: Positive = key(1.0, "Usable share of the velocity limits.", le=1.0)
    acceleration: Positive = key(
        200.0,
        "Largest joint acceleration, rad/s², also for braking before position limits: the motors must reach it.",
        le=1.0e5,
    )
    torque_rate: Positive = key(
        100.0, "Largest torque rate, in effort limits per second; applied per period.", le=1.0e3
    )
    self_collision: SelfCollisionSettings = key(SelfCollisionSettings(), "Distances between links.")
    torque_speed: TorqueSpeedSettings = key(TorqueSpeedSettings(), "Torque-speed curve of the motors.")

    @property
    def margin(self) -> float:
        """Enforced distance to the position limits, rad; 0 without position limits."""
        return self.position_margin if self.position else 0.0
