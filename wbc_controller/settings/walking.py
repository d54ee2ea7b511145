"""Settings of walking."""

from typing import Annotated, Literal

from pydantic import Field

from wbc_controller.settings.values import Positive, Section, key

_Time = Annotated[Positive, Field(le=5.0)]
_Duration = _Time | None  # None for the default
_Length = Annotated[Positive, Field(le=5.0)] | None  # None for the default


class WalkingSettings(Section):
    """Gait ([Walking](walking.md)). Defaults follow from the robot; z: height of its centre of mass.

    Left, right, width, least_width and max_step_width: bipeds only.
    """

    gait: Literal["trot", "walk"] | None = key(
        None, "Of a quadruped: `trot` (default): diagonal feet together; `walk`: one foot at a time."
    )
    left: str | None = key(None, "Contact of the left foot; default by position.")
    right: str | None = key(None, "Contact of the right foot; default by position.")
    single_support: _Duration = key(
        None, "Nominal duration of a swing, s; default √(z/g) times 1.5 (bipeds), 1.25 (trot) or 1.8 (walk)."
    )
    double_support: _Duration = key(None, "Duration on all feet between two swings, s; default 0.05, quadrupeds 0.03.")
    clearance: _Length = key(
        None,
        "Height of the swing foot above the ground, m; default 0.07·z, at most 0.6 of the feasible height; "
        "quadrupeds 0.18·z.",
    )
    lowering: Annotated[float, Field(ge=0.0, le=1.0)] | None = key(
        None,
        "Lowering of the centre of mass for bent knees, m; default 0.03·z, at most 0.2 of the feasible height "
        "of a foot; quadrupeds 0.",
    )
    width: _Length = key(None, "Distance between the feet, m; default 0.85 of the nominal one.")
    least_width: _Length = key(
        None, "Smallest distance, m; default 0.4 of that while standing, at least that of a sole and 0.03 m."
    )
    max_step_length: _Length = key(None, "Longest step, m; default 0.65·z; quadrupeds from below the body, 0.6·z.")
    max_step_width: _Length = key(None, "Largest distance, m; default 0.9·z.")
    command_timeout: _Time = key(0.5, "Age of the last `cmd_vel` after which the robot stops, s.")
    max_speed: Positive | None = key(
        None,
        "Largest speed forward, m/s, half backward; default √(g·z) times 0.12 (bipeds, at most 0.8 of the "
        "feasible speed), 0.5 (trot) or 0.06 (walk).",
    )
    max_side_speed: Positive | None = key(None, "The same sideways, m/s; factors 0.08, 0.25 and 0.03.")
    max_turn_rate: Positive | None = key(
        None, "Largest turning rate, rad/s; default 0.5 (bipeds, at most 0.8 of the feasible rate), 1.5 or 0.2."
    )
