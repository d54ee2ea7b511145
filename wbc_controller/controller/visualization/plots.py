"""Plotly figures.

Without plotly the functions raise `ConfigurationError`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from wbc_controller.controller.visualization.scene import ARROW, COLORS, LINE_LIST, SPHERE_LIST, Shape
from wbc_controller.extras import optional_libraries
from wbc_controller.records import Array

#: Colours legible on white and on black.
PALETTE = ("#2f7de1", "#e5812b", "#22a06b", "#d6455d", "#8a63d2", "#149eb0", "#b58900", "#7d8794")
BLUE, ORANGE, GREEN, RED = PALETTE[:4]
GREY = "#8b95a3"
POINTS = 2400  # largest number of points of a line
_MOST = 12  # number of actuators in the plot of a cycle
_HEAD = 0.2  # length of an arrowhead, as a share of the arrow
_CATEGORY, _AROUND = 22, 160  # heights of a category, and of axis and legend, pixels
_POLAR = 520  # height of a polar figure, pixels
_MARGIN = {"l": 74, "r": 16, "t": 8, "b": 46}


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """Line of a panel."""

    name: str  # in the legend
    x: Array  # (n,)
    y: Array  # (n,); NaN interrupts the line
    color: str = ""  # CSS colour; by default one colour per name
    dash: str = "solid"  # ``solid``, ``dash`` or ``dot``
    width: float = 1.7  # pixels
    group: str = ""  # group with one legend entry; by default the name
    filled: bool = False  # fill the area to zero


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """Lines with a common x axis."""

    axis: str  # title of the y axis
    lines: Sequence[Line]
    heading: str = ""
    span: float = 0.0  # smallest span of the y axis; 0 for the range of the data
    range: tuple[float, float] | None = None  # range of the y axis; None for the range of the data
    from_zero: bool = False  # extend the y axis to zero
    limit: float | None = None  # y of a dotted limit line


def line_panels(
    panels: Sequence[Panel],
    *,
    height: int,
    axis: str = "time [s]",
    marks: Mapping[str, Array] | None = None,
    shaded: Sequence[tuple[float, float]] = (),
    title: str = "",
) -> Any:
    """Return a figure of panels with thinned lines, below each other; `marks` (times by name) and `shaded` are in s."""
    _, make_subplots = _plotly()
    rows = len(panels) + bool(marks)
    headings = [panel.heading for panel in panels]
    figure = make_subplots(
        rows=rows,
        cols=1,
        shared_xaxes=True,
        vertical_spacing=(0.3 if any(headings) else 0.15) / rows,
        subplot_titles=[*headings, "binding constraints"][:rows] if any(headings) else None,
    )
    colors: dict[str, str] = {}
    groups: set[str] = set()
    for row, panel in enumerate(panels, 1):
        for line in panel.lines:
            group = line.group or line.name
            color = line.color or colors.setdefault(line.name, PALETTE[len(colors) % len(PALETTE)])
            x, y = thin_out(line.x, line.y)
            figure.add_scatter(
                x=x,
                y=y,
                name=line.name,
                mode="lines",
                line={"color": color, "dash": line.dash, "width": line.width},
                fill="tozeroy" if line.filled else None,
                fillcolor="rgba(139, 149, 163, 0.22)" if line.filled else None,
                connectgaps=False,
                hovertemplate="%{y:.4g}",
                legendgroup=group,
                legendgrouptitle={"text": group} if group == panel.heading else None,
                showlegend=group == panel.heading or group not in groups,
                row=row,
                col=1,
            )
            groups.add(group)
        if panel.limit is not None:
            figure.add_hline(y=panel.limit, line={"color": RED, "width": 1.2, "dash": "dot"}, row=row, col=1)
        figure.update_yaxes(
            title_text=panel.axis,
            range=_widened(panel) if panel.span else panel.range,
            rangemode="tozero" if panel.from_zero else None,
            row=row,
        )
    for name, times in (marks or {}).items():
        marker = {"symbol": "line-ns-open", "color": RED}
        figure.add_scatter(
            x=times, y=[name] * len(times), mode="markers", marker=marker, showlegend=False, row=rows, col=1
        )
    for start, end in shaded:
        figure.add_vrect(x0=start, x1=end, fillcolor="rgba(127, 140, 160, 0.10)", line_width=0, layer="below")
    figure.update_yaxes(title_standoff=8, nticks=6)
    figure.update_xaxes(title_text=axis, title_standoff=8, row=rows)
    style = {"title": title} if title else {"margin": _MARGIN, "hovermode": "x unified"}
    figure.update_layout(style, template="plotly_white", height=height)
    return figure


def _widened(panel: Panel) -> tuple[float, float] | None:
    values = np.concatenate([line.y for line in panel.lines])
    values = values[np.isfinite(values)]
    if not len(values):
        return None
    low, high = float(values.min()), float(values.max())
    margin = max(0.08 * (high - low), 0.5 * (panel.span - (high - low)))
    return low - margin, high + margin


@dataclass(frozen=True, slots=True)
class Series:
    """Values by category."""

    name: str
    categories: Sequence[str]  # category of each value; they may repeat, except for bars
    values: Sequence[float]
    color: str  # CSS colour
    symbol: str = "circle"  # ``bar`` or a plotly symbol
    texts: Sequence[str] = ()  # hover texts; by default the values


def by_category(
    series: Sequence[Series], *, axis: str, limit: float | None = None, range: tuple[float, float] | None = None
) -> Any:
    """Return a figure of series by category; `axis` and `range` belong to x, `limit` is a dashed line."""
    go, _ = _plotly()
    categories = list(dict.fromkeys(category for each in series for category in each.categories))
    figure = go.Figure()
    for each in series:
        common = {
            "name": each.name,
            "x": list(each.values),
            "y": list(each.categories),
            "hovertext": list(each.texts) or [f"{value:.4g}" for value in each.values],
            "hovertemplate": "%{y}: %{hovertext}",
        }
        if each.symbol == "bar":
            figure.add_bar(**common, orientation="h", marker={"color": each.color})
        else:
            marker = {"color": each.color, "symbol": each.symbol, "size": 9, "opacity": 0.7}
            if each.symbol != "circle":
                marker["line"] = {"width": 2.5, "color": each.color}
            figure.add_scatter(**common, mode="markers", marker=marker)
    if limit is not None:
        figure.add_vline(x=limit, line={"color": RED, "dash": "dash"})
    figure.update_layout(
        barmode="stack",
        template="plotly_white",
        height=_CATEGORY * len(categories) + _AROUND,
        legend={"orientation": "h", "y": 1.0, "yanchor": "bottom", "traceorder": "normal"},
        margin=_MARGIN,
    )
    figure.update_xaxes(title_text=axis, range=range, rangemode="tozero")
    figure.update_yaxes(
        categoryorder="array", categoryarray=categories, range=[len(categories) - 0.5, -0.5], automargin=True, dtick=1
    )
    return figure


def polar(lines: Mapping[str, Array], angles: Sequence[float], *, unit: str) -> Any:
    """Return a polar figure of closed lines by name, (n,) each, over angles in degrees; 0° is at the top."""
    go, _ = _plotly()
    figure = go.Figure()
    for (name, values), color in zip(lines.items(), PALETTE, strict=False):
        figure.add_scatterpolar(
            name=name,
            r=[*values, values[0]],
            theta=[*angles, angles[0]],
            mode="lines+markers",
            line={"color": color},
            hovertemplate=f"%{{theta:.0f}}°: %{{r:.1f}} {unit}",
        )
    axes = {"angularaxis": {"rotation": 90, "direction": "counterclockwise"}, "radialaxis": {"ticksuffix": f" {unit}"}}
    figure.update_layout(polar=axes, template="plotly_white", height=_POLAR, margin=_MARGIN)
    return figure


def thin_out(time: Array, values: Array) -> tuple[Array, Array]:
    """Reduce a line to `POINTS` points in single precision: extrema of each stretch, and gaps (NaN)."""
    if len(time) <= POINTS:
        return time, values
    keep = []
    for start, end in pairwise(np.linspace(0, len(time), POINTS // 2 + 1).astype(np.intp)):
        stretch = values[start:end]
        gap = np.isnan(stretch)
        offsets = [0, np.argmax(gap)] if gap.any() else [np.argmin(stretch), np.argmax(stretch)]
        keep += [start + offset for offset in offsets]
    chosen = np.unique(keep)
    return time[chosen].astype(np.float32), values[chosen].astype(np.float32)


def plot_cycle(shapes: Sequence[Shape], shares: Mapping[str, float], title: str, binding: Mapping[str, float]) -> Any:
    """Return a figure of one cycle: shapes, largest shares of torque limits, binding constraints."""
    go, make_subplots = _plotly()
    figure = make_subplots(
        cols=2, column_widths=[0.68, 0.32], specs=[[{"type": "scene"}, {"type": "bar"}]], horizontal_spacing=0.12
    )
    shown: set[str] = set()
    for shape in shapes:
        figure.add_trace(_shape_trace(go, shape, in_legend=shape.group not in shown), row=1, col=1)
        shown.add(shape.group)
    largest = sorted(shares.items(), key=lambda item: item[1])[-_MOST:]
    bound = {name.split(":")[1] for name in binding if name.startswith("torque:")}
    figure.add_bar(
        x=[100.0 * share for _, share in largest],
        y=[name for name, _ in largest],
        orientation="h",
        marker_color=[RED if name in bound else BLUE for name, _ in largest],
        showlegend=False,
        hovertemplate="%{y}: %{x:.1f} %<extra></extra>",
        row=1,
        col=2,
    )
    constraints = ", ".join(f"{name} ({value:.2g})" for name, value in binding.items()) or "none"
    figure.update_layout(
        title={"text": f"{title}<br><sup>binding constraints: {constraints}</sup>"},
        template="plotly_white",
        scene={
            "aspectmode": "data",
            **{f"{axis}axis_title": f"{axis}, m" for axis in "xyz"},
            "camera": {"eye": {"x": 2.6, "y": 1.6, "z": 1.0}},
        },
        legend={"orientation": "h", "y": -0.15},
        height=640,
    )
    figure.update_xaxes(title="torque, % of its limit", range=[0, 100], row=1, col=2)
    return figure


def _shape_trace(go: Any, shape: Shape, *, in_legend: bool) -> Any:
    r, g, b, opacity = COLORS[shape.group]
    color = f"rgb({255 * r:.0f}, {255 * g:.0f}, {255 * b:.0f})"
    points = shape.points
    if shape.kind == LINE_LIST:
        points = np.insert(points.reshape(-1, 2, 3), 2, np.nan, axis=1).reshape(-1, 3)
    elif shape.kind == ARROW:
        points = _arrow(points)
    x, y, z = points.T
    name = shape.group.replace("_", " ")
    common = {"name": name, "legendgroup": shape.group, "showlegend": in_legend, "x": x, "y": y, "z": z}
    if shape.kind == SPHERE_LIST:
        return go.Scatter3d(**common, mode="markers", marker={"size": 250.0 * shape.size, "color": color})
    width = 8 if shape.kind == ARROW else 4
    return go.Scatter3d(**common, mode="lines", opacity=opacity, line={"color": color, "width": width})


def _arrow(points: Array) -> Array:
    tail, tip = points
    along = tip - tail
    side = np.cross(along, [0.0, 1.0, 0.0] if abs(along[1]) < 0.9 * np.linalg.norm(along) else [1.0, 0.0, 0.0])
    back = tip - _HEAD * along
    return np.array([tail, tip, back + 0.4 * _HEAD * side, tip, back - 0.4 * _HEAD * side])


def plotly_script() -> str:
    """Return the JavaScript of plotly."""
    with optional_libraries():
        from plotly.offline import get_plotlyjs
    return str(get_plotlyjs())


def _plotly() -> tuple[Any, Any]:
    with optional_libraries():
        import plotly.graph_objects as go
        from plotly.subplots import make_subplots
    return go, make_subplots
