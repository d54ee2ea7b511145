"""Settings of the limits."""

from typing import TypeVar

from pydantic import Field, model_validator

from wbc_controller.settings.values import NonNegative, Positive, Section

_Curve = TypeVar("_Curve", bound="ActuatorTorqueSpeed | TorqueSpeedSettings")


def _require_falling(curve: _Curve) -> _Curve:
    if not (curve.corner < curve.no_load):
        raise ValueError(f"no_load = {curve.no_load}: must be above corner = {curve.corner}")
    return curve


class ActuatorTorqueSpeed(Section):
    """Torque-speed curve of one actuator."""

    corner: Positive = Field(le=1.0e4, description="Highest speed with the full effort limit, rad/s.")
    no_load: Positive = Field(le=1.0e4, description="Speed of zero torque, rad/s.")

    _ordered_speeds = model_validator(mode="after")(_require_falling)


class TorqueSpeedSettings(Section):
    """Torque-speed curve of the motors: from `corner` to `no_load` the torque in the direction of motion decreases."""

    enabled: bool = Field(False, description="Enforce the torque-speed curve.")
    corner: Positive = Field(
        0.5, le=10.0, description="Highest speed with the full effort limit, as a share of the URDF's velocity limit."
    )
    no_load: Positive = Field(
        1.0, le=10.0, description="Speed of zero torque, as a share of the URDF's velocity limit."
    )
    actuators: dict[str, ActuatorTorqueSpeed] = Field(
        default_factory=dict, description="Curves of single actuators; required for actuators in `robot.transmission`."
    )

    _ordered_speeds = model_validator(mode="after")(_require_falling)


class SelfCollisionSettings(Section):
    """Self-collision avoidance (docs/limits.md)."""

    enabled: bool = Field(False, description="Keep a distance between links.")
    margin: Positive = Field(0.02, le=0.5, description="Smallest distance, m.")
    acceleration: Positive = Field(
        20.0,
        le=1.0e3,
        description="Deceleration of approaching links, m/s². The motors must reach it with a stretched arm.",
    )
    horizon: NonNegative = Field(0.02, le=1.0, description="Look-ahead time, s, as `position_horizon`.")
    max_pairs: int = Field(12, ge=1, le=200, description="Number of constrained pairs per cycle: the most urgent ones.")
    srdf: str = Field("", description="Path of an SRDF, as `robot.urdf`; its disabled pairs are excluded.")
    visual: list[str] = Field(
        default_factory=list, description="Links with visual elements used as collision elements."
    )
    pairs: list[str] = Field(
        default_factory=list,
        description="Pairs `<link>/<link>`. Empty: all except links connected by one or two joints, disabled pairs "
        "of the SRDF, and pairs nearer than `margin` in `robot.posture`.",
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

    position: bool = Field(True, description="Enforce the URDF's joint position limits.")
    position_margin: NonNegative = Field(0.02, le=1.0, description="Distance to the position limits, rad.")
    position_horizon: NonNegative = Field(
        0.02,
        le=1.0,
        description="Look-ahead time of position and velocity limits, s, at least one period. Longer horizons brake "
        "earlier and are less sensitive to noise.",
    )
    velocity: bool = Field(True, description="Enforce the URDF's joint velocity limits.")
    velocity_scale: Positive = Field(1.0, le=1.0, description="Usable share of the velocity limits.")
    acceleration: Positive = Field(
        200.0,
        le=1.0e5,
        description="Largest joint acceleration, rad/s², also for braking before position limits: the motors must "
        "reach it.",
    )
    torque_rate: Positive = Field(
        100.0, le=1.0e3, description="Largest torque rate, in effort limits per second; applied per period."
    )
    self_collision: SelfCollisionSettings = Field(SelfCollisionSettings(), description="Distances between links.")
    torque_speed: TorqueSpeedSettings = Field(TorqueSpeedSettings(), description="Torque-speed curve of the motors.")

    @property
    def margin(self) -> float:
        """Enforced distance to the position limits, rad; 0 without position limits."""
        return self.position_margin if self.position else 0.0
