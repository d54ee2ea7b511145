"""Plots of a campaign."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from wbc_controller.controller.visualization.page_report import Plot
from wbc_controller.controller.visualization.plots import GREY, PALETTE, Series, by_category
from wbc_controller.validation.campaign.outcome import Outcome

if TYPE_CHECKING:
    from wbc_controller.validation.campaign.campaign_report import Row

#: Colours of the outcomes, in the order of the bars.
_COLORS = {
    "survived": "#22a06b",
    "STALE_INPUT": "#2f7de1",
    "ESTIMATE_LOST": "#c2569f",
    "IMPLAUSIBLE_STATE": "#8a63d2",
    "UNEXPLAINED_MOTION": "#a33b3b",
    "FALLING": "#f2b05e",
    "FALLEN": "#e5812b",
    "NO_SOLUTION": "#b58900",
    "RELAXED": "#149eb0",
    "BAD_TORQUE": "#7d8794",
    "CLOCK": "#4a4f9c",
    "ESTOP": "#b06a3b",
}
_VIOLATION = "#d6455d"


def campaign_plots(rows: Sequence[Row], outcomes: Sequence[Outcome]) -> list[Plot]:
    """Return the plots of a campaign."""
    detected = [each for each in outcomes if each.deadline is not None and each.after is not None]
    survived = [each for each in outcomes if not each.code]
    return [
        Plot(
            "shares",
            "Outcomes of the trials",
            "Share of the trials by kind of fault, all robots.",
            by_category(_shares(rows), axis="share of the trials [%]", range=(0.0, 104.0)),
        ),
        Plot(
            "delays",
            "Time until detection",
            "From the beginning of the fault until damping, as a share of the deadline; required: below 1. Only faults "
            "that must be detected.",
            by_category(
                _by_robot(detected, lambda each: (each.after or 0.0) / (each.deadline or 1.0), _delay),
                axis="time / deadline [1]",
                limit=1.0,
            ),
        ),
        Plot(
            "distances",
            "Motion of the robot",
            "Largest distance of the centre of mass from its position at the beginning of the fault, in survived "
            "trials.",
            by_category(_by_robot(survived, lambda each: each.moved, _distance), axis="distance [m]"),
        ),
    ]


def _shares(rows: Sequence[Row]) -> list[Series]:
    kinds = list(dict.fromkeys(row.kind for row in rows))
    trials = {kind: sum(row.trials for row in rows if row.kind == kind) for kind in kinds}
    series = []
    for name in dict.fromkeys([*_COLORS, *(code for row in rows for code in row.reasons)]):
        counts = {kind: sum(_count(row, name) for row in rows if row.kind == kind) for kind in kinds}
        if any(counts.values()):
            shares = [100.0 * counts[kind] / trials[kind] for kind in kinds]
            texts = [f"{counts[kind]} of {trials[kind]}" for kind in kinds]
            series.append(Series(name, kinds, shares, _COLORS.get(name, GREY), "bar", texts))
    bad = [kind for kind in kinds if any(row.violations for row in rows if row.kind == kind)]
    if bad:
        series.append(Series("violations", bad, [102.0] * len(bad), _VIOLATION, "x"))
    return series


def _count(row: Row, name: str) -> int:
    return row.survived if name == "survived" else row.reasons.get(name, 0)


def _by_robot(
    outcomes: Sequence[Outcome], value: Callable[[Outcome], float], text: Callable[[Outcome], str]
) -> list[Series]:
    series = []
    for i, robot in enumerate(dict.fromkeys(each.robot for each in outcomes)):
        own = [each for each in outcomes if each.robot == robot]
        points = [value(each) for each in own]
        color = PALETTE[i % len(PALETTE)]
        series.append(Series(robot, [each.kind for each in own], points, color, texts=[text(each) for each in own]))
    return series


def _delay(outcome: Outcome) -> str:
    return f"seed {outcome.seed}: {1e3 * (outcome.after or 0.0):.0f} of {1e3 * (outcome.deadline or 0.0):.0f} ms"


def _distance(outcome: Outcome) -> str:
    return f"seed {outcome.seed}: {outcome.moved:.3f} m"
