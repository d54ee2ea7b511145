"""Plots of a campaign, with plotly: what came of each kind of fault, and how soon it was detected."""

from __future__ import annotations

import html
from collections.abc import Sequence
from typing import TYPE_CHECKING

import plotly.graph_objects as go
import plotly.io

from wbc_controller.validation.campaign.outcome import Outcome

if TYPE_CHECKING:
    from wbc_controller.validation.campaign.campaign_report import Row

#: Colours of what can come of a trial, in the order of the bars.
_COLORS = {
    "survived": "#22a06b",
    "STALE_INPUT": "#2f7de1",
    "ESTIMATE_LOST": "#c2569f",
    "IMPLAUSIBLE_STATE": "#8a63d2",
    "FALLEN": "#e5812b",
    "NO_SOLUTION": "#b58900",
    "RELAXED": "#149eb0",
    "BAD_TORQUE": "#7d8794",
    "CLOCK": "#4a4f9c",
    "ESTOP": "#b06a3b",
    "violation": "#d6455d",
}
#: Height of the bars of one kind, and of what stands around them, in pixels.
_BAR, _AROUND = 22, 160


def page(rows: Sequence[Row], outcomes: Sequence[Outcome], summary: str) -> str:
    """A page with all plots; it needs no network."""
    parts = [
        ("What came of the trials", "Share of the trials of each kind of fault, on all robots.", _shares(rows)),
        (
            "How soon faults were detected",
            "Time from the beginning of the fault until damping, as a share of the deadline: every point has to be "
            "left of 1. Only faults that must be detected.",
            _delays(outcomes),
        ),
        (
            "How far the robot went",
            "Farthest that the centre of mass was from where it was at the beginning of the fault, in trials that the "
            "robot survived.",
            _distances(outcomes),
        ),
    ]
    body = "".join(
        f"<h2>{html.escape(title)}</h2><p>{html.escape(caption)}</p>"
        + plotly.io.to_html(figure, include_plotlyjs=(i == 0), full_html=False)
        for i, (title, caption, figure) in enumerate(parts)
    )
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>Fault campaign</title>'
        "<style>body{font:16px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem}</style>"
        f"<h1>Fault campaign</h1><p>{html.escape(summary)}.</p>{body}</html>"
    )


def _shares(rows: Sequence[Row]) -> go.Figure:
    """Stacked bars: what came of each kind."""
    kinds = list(dict.fromkeys(row.kind for row in rows))
    trials = {kind: sum(row.trials for row in rows if row.kind == kind) for kind in kinds}
    found = list(dict.fromkeys(code for row in rows for code in row.reasons))
    figure = go.Figure()
    for name in [*_COLORS, *(code for code in found if code not in _COLORS)]:
        counts = {kind: sum(_count(row, name) for row in rows if row.kind == kind) for kind in kinds}
        if name != "violation" and any(counts.values()):
            figure.add_bar(
                y=kinds,
                x=[100.0 * counts[kind] / trials[kind] for kind in kinds],
                customdata=[[counts[kind], trials[kind]] for kind in kinds],
                name=name,
                orientation="h",
                marker_color=_COLORS.get(name, "#8b95a3"),
                hovertemplate="%{y}: %{customdata[0]} of %{customdata[1]}<extra>%{fullData.name}</extra>",
            )
    bad = [kind for kind in kinds if any(row.violations for row in rows if row.kind == kind)]
    figure.add_scatter(
        y=bad, x=[102.0] * len(bad), mode="markers", name="violations", showlegend=bool(bad),
        marker={"symbol": "x", "color": _COLORS["violation"], "size": 9},
    )  # fmt: skip
    figure.update_layout(
        barmode="stack",
        template="plotly_white",
        height=_BAR * len(kinds) + _AROUND,
        legend={"orientation": "h", "y": 1.0, "yanchor": "bottom", "traceorder": "normal"},
        margin={"l": 10, "r": 10, "t": 60, "b": 50},
    )
    figure.update_xaxes(title="share of the trials, %", range=[0, 104])
    figure.update_yaxes(range=[len(kinds) - 0.5, -0.5], automargin=True, dtick=1)
    return figure


def _count(row: Row, name: str) -> int:
    return row.survived if name == "survived" else row.reasons.get(name, 0)


def _delays(outcomes: Sequence[Outcome]) -> go.Figure:
    """Points: time until detection over its deadline, by kind."""
    chosen = [o for o in outcomes if o.deadline is not None and o.after is not None]
    figure = go.Figure()
    for robot, color in zip(dict.fromkeys(o.robot for o in chosen), _ROBOT_COLORS * len(chosen), strict=False):
        mine = [o for o in chosen if o.robot == robot]
        figure.add_scatter(
            x=[(o.after or 0.0) / (o.deadline or 1.0) for o in mine],
            y=[o.kind for o in mine],
            customdata=[[1e3 * (o.after or 0.0), 1e3 * (o.deadline or 0.0), o.seed] for o in mine],
            mode="markers",
            name=robot,
            marker={"color": color, "opacity": 0.6},
            hovertemplate="%{y}, seed %{customdata[2]}: %{customdata[0]:.0f} of %{customdata[1]:.0f} ms",
        )
    return _by_kind(figure, chosen, "time until detection over the deadline", line=1.0)


def _distances(outcomes: Sequence[Outcome]) -> go.Figure:
    """Boxes: how far the centre of mass went, by kind."""
    chosen = [o for o in outcomes if not o.code]
    figure = go.Figure()
    for robot, color in zip(dict.fromkeys(o.robot for o in chosen), _ROBOT_COLORS * len(chosen), strict=False):
        mine = [o for o in chosen if o.robot == robot]
        figure.add_scatter(
            x=[o.moved for o in mine],
            y=[o.kind for o in mine],
            customdata=[[o.seed] for o in mine],
            mode="markers",
            name=robot,
            marker={"color": color, "opacity": 0.6},
            hovertemplate="%{y}, seed %{customdata[0]}: %{x:.3f} m",
        )
    return _by_kind(figure, chosen, "distance, m")


#: Colours of the robots.
_ROBOT_COLORS = ("#2f7de1", "#e5812b", "#22a06b", "#8a63d2", "#149eb0")


def _by_kind(figure: go.Figure, outcomes: Sequence[Outcome], title: str, line: float | None = None) -> go.Figure:
    """Lay out a figure with one line per kind."""
    kinds = list(dict.fromkeys(outcome.kind for outcome in outcomes))
    if line is not None:
        figure.add_vline(x=line, line={"color": _COLORS["violation"], "dash": "dash"})
    figure.update_layout(
        template="plotly_white",
        height=_BAR * len(kinds) + _AROUND,
        legend={"orientation": "h", "y": 1.0, "yanchor": "bottom"},
        margin={"l": 10, "r": 10, "t": 60, "b": 50},
    )
    figure.update_xaxes(title=title, rangemode="tozero")
    figure.update_yaxes(
        categoryorder="array", categoryarray=kinds, range=[len(kinds) - 0.5, -0.5], automargin=True, dtick=1
    )
    return figure
