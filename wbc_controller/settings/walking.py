"""Settings of walking."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from wbc_controller.settings.values import Positive, Section

_Time = Annotated[Positive, Field(le=5.0)]
_Length = Annotated[Positive, Field(le=5.0)]


class WalkingSettings(Section):
    """Gait of a biped or quadruped. Every key has a default that follows from the robot.

    z is the height of its centre of mass. Left, right, width, least_width and max_step_width: bipeds only.
    """

    gait: Literal["trot", "walk"] | None = Field(
        None,
        description="Gait of a quadruped: `trot` (default, diagonal feet together) or `walk` (one foot at a time).",
    )
    left: str | None = Field(None, description="Contact of the left foot; default: the surface contact to the left.")
    right: str | None = Field(None, description="Contact of the right foot; default: the surface contact to the right.")
    single_support: _Time | None = Field(
        None,
        description="Nominal duration of a swing, s; default 1.5·√(z/g) for bipeds, 1.25·√(z/g) for a trot, 1.8·√(z/g) "
        "for a walk.",
    )
    double_support: _Time | None = Field(
        None, description="Duration of the support by all feet between two swings, s; default 0.05, quadrupeds 0.03."
    )
    clearance: _Length | None = Field(
        None,
        description="Height of the swing foot above the ground, m; default 0.07·z, at most 0.6 of the height to which "
        "a biped can raise its flat feet; quadrupeds 0.18·z.",
    )
    lowering: Annotated[float, Field(ge=0.0, le=1.0)] | None = Field(
        None,
        description="Distance by which the centre of mass is lowered while walking, m: long steps need bent knees; "
        "default 0.03·z, at most 0.2 of the height to which a biped can raise its flat feet; quadrupeds 0.",
    )
    width: _Length | None = Field(
        None, description="Distance between the feet, m; default 0.85 of that in the nominal posture."
    )
    least_width: _Length | None = Field(
        None,
        description="Smallest distance between the feet, m; default 0.6 of that in the nominal posture, and at least "
        "the width of a sole and 0.03 m.",
    )
    max_step_length: _Length | None = Field(
        None, description="Longest step, m; default 0.65·z. Quadrupeds: from below the body to the foot; default 0.6·z."
    )
    max_step_width: _Length | None = Field(None, description="Largest distance between the feet, m; default 0.8·z.")
    command_timeout: _Time = Field(
        0.5, description="Time without a message on `cmd_vel` after which the robot stops, s."
    )
    max_speed: Positive | None = Field(
        None,
        description="Largest speed forward, m/s; default 0.12·√(g·z), at most 0.8 of the feasible speed; trot "
        "0.5·√(g·z), walk 0.06·√(g·z). Backward half of it.",
    )
    max_side_speed: Positive | None = Field(
        None,
        description="Largest speed sideways, m/s; default 0.08·√(g·z), at most 0.8 of the feasible speed; trot "
        "0.25·√(g·z), walk 0.03·√(g·z).",
    )
    max_turn_rate: Positive | None = Field(
        None,
        description="Largest turning rate, rad/s; default 0.5, at most 0.8 of the feasible rate; trot 1.5, walk 0.2.",
    )
