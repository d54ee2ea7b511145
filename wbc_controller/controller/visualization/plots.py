"""Plots of what the controller did, with plotly: one cycle in the world, and a run over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from wbc_controller.controller.visualization.scene import ARROW, COLORS, LINE_LIST, SPHERE_LIST, Shape
from wbc_controller.errors import ConfigurationError
from wbc_controller.records import Array

#: Actuators that are shown: those with the largest shares.
_MOST = 12
#: Length of an arrow's head, as a share of its length.
_HEAD = 0.2
_LINE_COLORS = ("#2980b9", "#c0392b", "#27ae60", "#8e44ad", "#f39c12", "#16a085", "#7f8c8d", "#d35400")


def plot_cycle(shapes: Sequence[Shape], shares: Mapping[str, float], title: str, binding: Mapping[str, float]) -> Any:
    """Draw one cycle: shapes in the world, and beside them the largest torques as shares of their limits.

    Args:
        shapes: from `scene.draw`.
        shares: of each actuator its torque as a share of its limit.
        title: of the figure.
        binding: the binding constraints, with their multipliers.

    Returns:
        A plotly Figure.

    Raises:
        ConfigurationError: where plotly is not installed.
    """
    go, make_subplots = _plotly()
    figure = make_subplots(
        cols=2, column_widths=[0.68, 0.32], specs=[[{"type": "scene"}, {"type": "bar"}]], horizontal_spacing=0.12
    )
    shown: set[str] = set()
    for shape in shapes:
        first = shape.group not in shown
        shown.add(shape.group)
        figure.add_trace(_trace(go, shape, first), row=1, col=1)
    largest = sorted(shares.items(), key=lambda item: item[1])[-_MOST:]
    bound = {name.split(":")[1] for name in binding if name.startswith("torque:")}
    figure.add_trace(
        go.Bar(
            x=[100.0 * share for _, share in largest],
            y=[name for name, _ in largest],
            orientation="h",
            marker_color=["#c0392b" if name in bound else "#2980b9" for name, _ in largest],
            showlegend=False,
            hovertemplate="%{y}: %{x:.1f} %<extra></extra>",
        ),
        row=1,
        col=2,
    )
    said = ", ".join(f"{name} ({value:.2g})" for name, value in binding.items()) or "none"
    figure.update_layout(
        title={"text": f"{title}<br><sup>binding constraints: {said}</sup>"},
        template="plotly_white",
        scene={
            "aspectmode": "data",
            "xaxis_title": "x, m",
            "yaxis_title": "y, m",
            "zaxis_title": "z, m",
            "camera": {"eye": {"x": 2.6, "y": 1.6, "z": 1.0}},
        },
        legend={"orientation": "h", "y": -0.15},
        height=640,
    )
    figure.update_xaxes(title="torque, % of its limit", range=[0, 100], row=1, col=2)
    return figure


def plot_series(time: Array, panels: Mapping[str, Mapping[str, Array]], marks: Mapping[str, Array], title: str) -> Any:
    """Draw series over time in panels below each other, and below them when each constraint was binding.

    Args:
        time: (n,) in s.
        panels: by heading, series by name, each (n,); NaN where there is no value.
        marks: by name of the constraint, the times at which it was binding, s.
        title: of the figure.

    Returns:
        A plotly Figure.

    Raises:
        ConfigurationError: where plotly is not installed.
    """
    go, make_subplots = _plotly()
    rows = len(panels) + bool(marks)
    figure = make_subplots(
        rows=rows,
        cols=1,
        shared_xaxes=True,
        vertical_spacing=0.06,
        subplot_titles=[*panels, "binding constraints"][:rows],
    )
    names = list(dict.fromkeys(name for series in panels.values() for name in series))
    for row, (heading, series) in enumerate(panels.items(), 1):
        for name, values in series.items():
            color = _LINE_COLORS[names.index(name) % len(_LINE_COLORS)]  # one name has one colour in all panels
            figure.add_trace(
                go.Scatter(
                    x=time,
                    y=values,
                    name=name,
                    line={"color": color},
                    legendgroup=heading,
                    legendgrouptitle={"text": heading},
                ),
                row=row,
                col=1,
            )
    for name, times in marks.items():
        figure.add_trace(
            go.Scatter(
                x=times,
                y=[name] * len(times),
                mode="markers",
                marker={"symbol": "line-ns-open", "color": "#c0392b"},
                showlegend=False,
            ),
            row=rows,
            col=1,
        )
    figure.update_layout(title=title, template="plotly_white", height=180 * rows + 120)
    figure.update_xaxes(title="time, s", row=rows, col=1)
    return figure


def _trace(go: Any, shape: Shape, first: bool) -> Any:
    r, g, b, opacity = COLORS[shape.group]
    color = f"rgb({255 * r:.0f}, {255 * g:.0f}, {255 * b:.0f})"
    points = shape.points
    if shape.kind == LINE_LIST:
        points = np.insert(points.reshape(-1, 2, 3), 2, np.nan, axis=1).reshape(-1, 3)
    elif shape.kind == ARROW:
        points = _arrow(points)
    x, y, z = points.T
    common = {"name": shape.group.replace("_", " "), "legendgroup": shape.group, "showlegend": first, "x": x, "y": y}
    if shape.kind == SPHERE_LIST:
        return go.Scatter3d(**common, z=z, mode="markers", marker={"size": 250.0 * shape.size, "color": color})
    width = 8 if shape.kind == ARROW else 4
    return go.Scatter3d(**common, z=z, mode="lines", opacity=opacity, line={"color": color, "width": width})


def _arrow(points: Array) -> Array:
    """An arrow as a line: shaft, and two strokes for its head."""
    tail, tip = points
    along = tip - tail
    side = np.cross(along, [0.0, 1.0, 0.0] if abs(along[1]) < 0.9 * np.linalg.norm(along) else [1.0, 0.0, 0.0])
    back = tip - _HEAD * along
    return np.array([tail, tip, back + 0.4 * _HEAD * side, tip, back - 0.4 * _HEAD * side])


def _plotly() -> tuple[Any, Any]:
    try:
        import plotly.graph_objects as go
        from plotly.subplots import make_subplots
    except ModuleNotFoundError as error:
        raise ConfigurationError(
            f"plots need plotly ({error}); install it with: pip install 'wbc_controller[plots]'"
        ) from error
    return go, make_subplots
