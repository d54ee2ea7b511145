"""Settings of the limits in the quadratic program."""

from __future__ import annotations

from typing import Annotated, TypeVar

from pydantic import Field, model_validator

from wbc_controller.settings.values import NonNegative, Positive, Section

_Curve = TypeVar("_Curve", bound="ActuatorTorqueSpeed | TorqueSpeedSettings")


def _falling(curve: _Curve) -> _Curve:
    if not (curve.corner < curve.no_load):
        raise ValueError(f"no_load = {curve.no_load}: must be above corner = {curve.corner}")
    return curve


class ActuatorTorqueSpeed(Section):
    """The torque-speed curve of one actuator."""

    corner: Positive = Field(le=1.0e4, description="Speed up to which the effort limit is available, rad/s.")
    no_load: Positive = Field(le=1.0e4, description="Speed at which no torque is available, rad/s.")

    @model_validator(mode="after")
    def _falls(self) -> ActuatorTorqueSpeed:
        return _falling(self)


class TorqueSpeedSettings(Section):
    """Torque-speed curve of the motors: above the corner speed, less torque is available in the direction of motion."""

    enabled: bool = Field(False, description="Enforce the torque-speed curve.")
    corner: Positive = Field(
        0.5,
        le=10.0,
        description="Speed up to which the effort limit is available, as a share of the URDF's velocity limit.",
    )
    no_load: Positive = Field(
        1.0, le=10.0, description="Speed at which no torque is available, as a share of the URDF's velocity limit."
    )
    actuators: dict[str, ActuatorTorqueSpeed] = Field(
        default_factory=dict, description="Values of single actuators; required for those in `robot.transmission`."
    )

    @model_validator(mode="after")
    def _falls(self) -> TorqueSpeedSettings:
        return _falling(self)


class SelfCollisionSettings(Section):
    """Self-collision avoidance: links that could collide are kept at a distance from each other."""

    enabled: bool = Field(False, description="Keep links apart, by the collision elements of the URDF.")
    margin: Annotated[Positive, Field(le=0.5)] = Field(0.02, description="Smallest distance, m.")
    acceleration: Annotated[Positive, Field(le=1.0e3)] = Field(
        20.0,
        description="Deceleration with which approaching links must be able to stop before the margin, m/s²: choose a "
        "value that the motors reach with the arm stretched out.",
    )
    horizon: NonNegative = Field(
        0.02,
        le=1.0,
        description="Time over which the limit looks ahead, s, at least one period; as `position_horizon`.",
    )
    max_pairs: int = Field(12, ge=1, le=200, description="Number of pairs constrained in one cycle: the most urgent.")
    srdf: str = Field(
        "", description="Path of an SRDF, in the form of `robot.urdf`; pairs it disables are left out. Empty: none."
    )
    visual: list[str] = Field(
        default_factory=list,
        description="Links whose visual elements serve as collision elements; meant for links without any.",
    )
    pairs: list[str] = Field(
        default_factory=list,
        description="The pairs to keep apart, each `<link>/<link>`. Empty: all pairs but links that are connected by "
        "one or two joints, those that the SRDF disables, and those nearer than the margin in `robot.posture`.",
    )


class LimitSettings(Section):
    """Limits in the quadratic program; the torque limits always apply."""

    live = ("position_margin", "position_horizon", "velocity_scale", "acceleration")
    # What the three shipped robots sway and squat through. Above 0.2 rad the margin leaves G1's ankles no room. With
    # 5 rad/s², or a tenth of the velocities, bounds have to be relaxed. With 300 rad/s² instead of the configured
    # 200 Go2's thighs pass their limits by 0.11 rad.
    live_ranges = {  # noqa: RUF012 - declared as a class variable above
        "position_margin": (0.0, 0.2),
        "velocity_scale": (0.15, 1.0),
        "acceleration": (20.0, None),
    }

    position: bool = Field(True, description="Enforce the URDF's joint position limits.")
    position_margin: NonNegative = Field(0.02, le=1.0, description="Distance kept from the position limits, rad.")
    position_horizon: NonNegative = Field(
        0.02,
        le=1.0,
        description="Time over which the limits of position and velocity look ahead, s, at least one period: a longer "
        "horizon brakes earlier, and is less sensitive to noise and to torques that come late.",
    )
    velocity: bool = Field(True, description="Enforce the URDF's joint velocity limits.")
    velocity_scale: Annotated[Positive, Field(le=1.0)] = Field(1.0, description="Usable share of the velocity limits.")
    acceleration: Positive = Field(
        200.0,
        le=1.0e5,
        description="Largest joint acceleration, rad/s². A joint must be able to brake with it before its position "
        "limit: choose a value that the motors can reach. Only a joint that would run into its stop brakes harder.",
    )
    torque_rate: Positive = Field(
        100.0,
        le=1.0e3,
        description="Largest torque change, in effort limits per second; by one period's worth at most per command.",
    )
    self_collision: SelfCollisionSettings = Field(SelfCollisionSettings(), description="Distances between links.")
    torque_speed: TorqueSpeedSettings = Field(TorqueSpeedSettings(), description="Torque-speed curve of the motors.")
