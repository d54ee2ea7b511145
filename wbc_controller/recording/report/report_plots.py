"""The plots of a report, as plotly figures; the page sets the colours of background and text."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import cycle, pairwise

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from wbc_controller.recording.report.run_record import Recording
from wbc_controller.records import Array

#: Mid-tones that are legible on white and on black.
PALETTE = ("#2f7de1", "#e5812b", "#22a06b", "#d6455d", "#8a63d2", "#149eb0", "#b58900", "#7d8794")
GREY = "#8b95a3"
#: Largest number of points of one line: more than its pixels.
POINTS = 2400
#: Share of a contact's largest normal force below which its use of friction is mere noise, and not shown.
LIGHT = 0.05
#: Joints whose torque is drawn as a line of its own.
BUSIEST = 6


@dataclass(frozen=True, slots=True)
class Plot:
    """One plot of the page.

    Attributes:
        key: id of its element in the page.
        title: title of the plot.
        caption: one sentence on how to read it.
        figure: the plotly figure.
        over_time: whether its x axis is the time of the run.
    """

    key: str
    title: str
    caption: str
    figure: go.Figure
    over_time: bool = True


def build_plots(recording: Recording) -> list[Plot]:
    """Build every plot that the recording has data for."""
    plots = [_com(recording), _torques(recording)]
    if recording.contact_wrenches:
        plots += [_forces(recording), _friction(recording)]
    if recording.frame_errors:
        plots.append(_errors(recording))
    if recording.audit:
        plots.append(_audit(recording))
    if len(recording.cycle_seconds):
        plots.append(_cycles(recording))
    if recording.stage_seconds and len(recording.cycle_seconds):
        plots.append(_stages(recording))
    return plots


def phases(recording: Recording) -> list[tuple[float, float, str]]:
    """List the phases of the run: start, end and name."""
    starts = [event.time for event in recording.events]
    ends = [*starts[1:], float(recording.time[-1])]
    return [(start, end, event.name) for start, end, event in zip(starts, ends, recording.events, strict=False)]


def friction_use(wrench: Array, coefficient: float) -> Array:
    """Return the share of the friction cone that a contact uses, |f_t| / (μ f_z), (n,); NaN under a small load.

    Args:
        wrench: force or wrench of the contact, (n, k) in N, normal along the third axis.
        coefficient: μ.
    """
    normal = wrench[:, 2]
    borne = normal > LIGHT * np.nanmax(normal, initial=0.0)
    use = np.full(len(wrench), np.nan)
    use[borne] = np.linalg.norm(wrench[borne, :2], axis=1) / (coefficient * normal[borne])
    return use


def decimate(time: Array, values: Array, points: int = POINTS) -> tuple[Array, Array]:
    """Thin out a line so that it looks the same: each stretch keeps its lowest and its highest sample.

    Args:
        time: (n,).
        values: (n,), with NaN where the line has gaps.
        points: about how many samples to keep.
    """
    n = len(time)
    if n <= points:
        return time, values
    edges = np.linspace(0, n, points // 2 + 1).astype(np.intp)
    keep = []
    for start, end in pairwise(edges):
        stretch = values[start:end]
        if np.isnan(stretch).any():
            # One gap and one value are enough to show where the line is interrupted.
            keep += [start, start + int(np.argmax(np.isnan(stretch)))]
            continue
        keep += [start + int(np.argmin(stretch)), start + int(np.argmax(stretch))]
    chosen = np.unique(keep)
    return time[chosen], values[chosen]


def _com(recording: Recording) -> Plot:
    figure = make_subplots(rows=3, cols=1, shared_xaxes=True, vertical_spacing=0.05)
    for row, axis in enumerate("xyz", start=1):
        reference, actual = recording.com_reference[:, row - 1], recording.com[:, row - 1]
        first = row == 1
        _line(figure, recording.time, actual, "centre of mass", PALETTE[0], row=row, shown=first, group="com")
        _line(
            figure, recording.time, reference, "reference", PALETTE[1],
            row=row, shown=first, group="reference", dash="dash", width=1.4,
        )  # fmt: skip
        figure.update_yaxes(title_text=f"{axis} [m]", row=row)
        _at_least(figure, row, np.concatenate([actual, reference]), 0.02)
    _finish(figure, recording, height=500)
    return Plot("com", "Centre of mass", "Position in the world against its reference.", figure)


def _torques(recording: Recording) -> Plot:
    use = 100.0 * np.abs(recording.tau) / recording.effort_limits  # (n, na) in %
    peaks = np.max(np.nan_to_num(use), axis=0, initial=0.0)  # (na,)
    figure = make_subplots(rows=1, cols=1)
    time, envelope = decimate(recording.time, use.max(axis=1, initial=0.0))
    figure.add_scatter(
        x=_single(time), y=_single(envelope), name="largest of all joints", mode="lines", fill="tozeroy",
        line={"width": 0.8, "color": GREY}, fillcolor="rgba(139, 149, 163, 0.22)",
    )  # fmt: skip
    for joint, color in zip(np.argsort(-peaks)[:BUSIEST], PALETTE, strict=False):
        name = recording.actuators[joint].removesuffix("_joint")
        _line(figure, recording.time, use[:, joint], name, color, width=1.2)
    figure.add_hline(y=100.0, line={"color": PALETTE[3], "width": 1.2, "dash": "dot"})
    figure.update_yaxes(title_text="|torque| / limit [%]", range=[0.0, 108.0])
    _finish(figure, recording, height=330)
    return Plot(
        "torques", "Torques as a share of their limits",
        "The busiest joints by name, and the envelope of all of them. The dotted line is the effort limit.", figure,
    )  # fmt: skip


def _forces(recording: Recording) -> Plot:
    names = list(recording.contact_wrenches)
    figure = make_subplots(rows=len(names), cols=1, shared_xaxes=True, vertical_spacing=0.14 / len(names))
    for row, name in enumerate(names, start=1):
        if name in recording.true_wrenches:
            true = recording.true_wrenches[name][:, 2]
            _line(
                figure, recording.time, true, "given by the ground", PALETTE[1],
                row=row, shown=row == 1, group="true", width=1.2, rank=2,
            )  # fmt: skip
        planned = recording.contact_wrenches[name][:, 2]
        _line(
            figure, recording.time, planned, "counted on by the QP", PALETTE[0],
            row=row, shown=row == 1, group="planned",
        )  # fmt: skip
        figure.update_yaxes(title_text=f"{name.replace('_', ' ')}<br>f<sub>z</sub> [N]", rangemode="tozero", row=row)
    _finish(figure, recording, height=110 + 145 * len(names))
    return Plot(
        "forces", "Vertical contact forces",
        "What the quadratic program counts on"
        + (", and what the ground really gave," if recording.true_wrenches else "") + " along each contact's normal.",
        figure,
    )  # fmt: skip


def _friction(recording: Recording) -> Plot:
    figure = make_subplots(rows=1, cols=1)
    for (name, wrench), color in zip(recording.contact_wrenches.items(), cycle(PALETTE)):
        coefficient = recording.friction.get(name)
        if coefficient is None:  # a fixed contact: no cone
            continue
        label = f"{name.replace('_', ' ')} (μ = {coefficient:g})"
        if name in recording.true_wrenches:
            true = friction_use(recording.true_wrenches[name], coefficient)
            _line(figure, recording.time, true, "ground", color, shown=False, group=label, width=1.0, dash="dot")
        _line(figure, recording.time, friction_use(wrench, coefficient), label, color)
    figure.add_hline(y=1.0, line={"color": PALETTE[3], "width": 1.2, "dash": "dot"})
    figure.update_yaxes(title_text="|f<sub>t</sub>| / (μ f<sub>z</sub>) [1]", rangemode="tozero")
    _finish(figure, recording, height=300)
    return Plot(
        "friction", "Use of friction",
        ("Solid: counted on by the QP; dotted: given by the ground. " if recording.true_wrenches
         else "As the QP counts on it. ") + "At 1 a contact slips. Not shown while a contact "
        f"bears less than {LIGHT:.0%} of its largest load.", figure,
    )  # fmt: skip


def _errors(recording: Recording) -> Plot:
    figure = make_subplots(rows=1, cols=1)
    for (name, error), color in zip(recording.frame_errors.items(), cycle(PALETTE)):
        _line(figure, recording.time, error, name.replace("_", " "), color)
    figure.update_yaxes(title_text="error [m or rad]", rangemode="tozero")
    _finish(figure, recording, height=280)
    return Plot("errors", "Task errors", "Norm of each task's error: m for positions, rad for orientations.", figure)


def _audit(recording: Recording) -> Plot:
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.08)
    audit = recording.audit
    _line(figure, recording.time, audit["force"], "force on the centre of mass", PALETTE[3], row=1)
    _line(figure, recording.time, audit["energy"], "energy residual", PALETTE[4], row=2)
    figure.update_yaxes(title_text="force [N]", rangemode="tozero", row=1)
    figure.update_yaxes(title_text="power [W]", row=2)
    _finish(figure, recording, height=360)
    caption = "What the model does not account for: nothing while the robot is left alone, and every shove."
    return Plot("audit", "Model audit", caption, figure)


def _cycles(recording: Recording) -> Plot:
    milliseconds = 1.0e3 * recording.cycle_seconds
    median, p99 = np.percentile(milliseconds, [50.0, 99.0])
    # A few late cycles would squeeze all others into one bar: they are counted in the last bar.
    end = float(max(np.percentile(milliseconds, 99.8) * 1.05, 1.25 * median))
    counts, edges = np.histogram(np.minimum(milliseconds, end), bins=70, range=(0.0, end))
    share = 100.0 * counts / len(milliseconds)
    figure = make_subplots(rows=1, cols=1)
    centers, top = (edges[:-1] + edges[1:]) / 2.0, float(share.max()) * 1.06
    figure.add_bar(
        x=_single(centers), y=_single(share), name=f"{len(milliseconds):,} cycles", marker={"color": PALETTE[0]},
        hovertemplate="%{x:.2f} ms: %{y:.2f} %<extra></extra>",
    )  # fmt: skip
    for value, name, color in ((median, "median", PALETTE[2]), (p99, "99th percentile", PALETTE[1])):
        figure.add_scatter(
            x=[value, value], y=[0.0, top], mode="lines", name=f"{name} {value:.2f} ms",
            line={"color": color, "width": 2.0, "dash": "dash"}, hoverinfo="skip",
        )  # fmt: skip
    figure.update_layout(bargap=0.06)
    figure.update_xaxes(title_text="time of one control cycle [ms]", range=[0.0, end * 1.01])
    figure.update_yaxes(title_text="share of cycles [%]", range=[0.0, top])
    _finish(figure, None, height=320)
    late = int((milliseconds > end).sum())
    caption = f"Slowest: {milliseconds.max():.2f} ms." + (f" The last bar holds {late} longer cycles." if late else "")
    return Plot("cycles", "Cycle times", caption, figure, over_time=False)


def _stages(recording: Recording) -> Plot:
    names = list(recording.stage_seconds)
    quantiles = np.array(
        [1.0e3 * np.nanpercentile(recording.stage_seconds[name], [50.0, 99.0]) for name in names]
    )  # (stages, 2) in ms
    labels = [name.replace("_", " ") for name in names]
    figure = make_subplots(rows=1, cols=1)
    figure.add_bar(
        x=_single(quantiles[:, 0]), y=labels, orientation="h", name="median", marker={"color": PALETTE[0]},
        hovertemplate="%{y}: %{x:.3f} ms<extra>median</extra>",
    )  # fmt: skip
    figure.add_scatter(
        x=_single(quantiles[:, 1]), y=labels, mode="markers", name="99th percentile",
        marker={"color": PALETTE[1], "symbol": "line-ns", "size": 15, "line": {"width": 2.5, "color": PALETTE[1]}},
        hovertemplate="%{y}: %{x:.3f} ms<extra>99th percentile</extra>",
    )  # fmt: skip
    figure.update_layout(bargap=0.45)
    figure.update_xaxes(title_text="time in one cycle [ms]", rangemode="tozero")
    figure.update_yaxes(autorange="reversed", title_text="stage")
    _finish(figure, None, height=320)
    return Plot("stages", "Stages of a cycle", "Where the time of a cycle goes.", figure, over_time=False)


def _line(
    figure: go.Figure,
    time: Array,
    values: Array,
    name: str,
    color: str,
    *,
    row: int = 1,
    shown: bool = True,
    group: str | None = None,
    dash: str = "solid",
    width: float = 1.7,
    rank: int = 1,
) -> None:
    x, y = decimate(time, values)
    figure.add_scatter(
        x=_single(x), y=_single(y), name=name, mode="lines", row=row, col=1, showlegend=shown,
        legendgroup=group or name, legendrank=rank, connectgaps=False, hovertemplate="%{y:.4g}",
        line={"color": color, "dash": dash, "width": width},
    )  # fmt: skip


def _finish(figure: go.Figure, recording: Recording | None, height: int) -> None:
    """Set the common properties of a figure: size, margins, and the phases of the run in its background."""
    figure.update_layout(
        # The page draws the legend, so that it wraps on narrow screens and never covers a line.
        template=None, height=height, showlegend=False, margin={"l": 74, "r": 16, "t": 8, "b": 46},
    )  # fmt: skip
    figure.update_yaxes(automargin=False, title_standoff=8, nticks=6)
    if recording is None:
        figure.update_yaxes(automargin=True)
        return
    span = [float(recording.time[0]), float(recording.time[-1])]
    figure.update_xaxes(range=span)
    rows = len(list(figure.select_xaxes()))
    figure.update_xaxes(title_text="time [s]", title_standoff=8, row=rows)
    figure.update_layout(hovermode="x unified")
    for start, end in _every_other(phases(recording)):
        figure.add_vrect(x0=start, x1=end, fillcolor="rgba(127, 140, 160, 0.10)", line_width=0, layer="below")


def _every_other(spans: Sequence[tuple[float, float, str]]) -> Iterator[tuple[float, float]]:
    for start, end, _ in spans[1::2]:
        yield start, end


def _at_least(figure: go.Figure, row: int, values: Array, span: float) -> None:
    """Give an axis a smallest span, so that it does not magnify noise."""
    values = values[np.isfinite(values)]
    if not len(values):
        return
    low, high = float(values.min()), float(values.max())
    margin = max(0.08 * (high - low), 0.5 * (span - (high - low)))
    figure.update_yaxes(range=[low - margin, high + margin], row=row)


def _single(values: Array) -> np.ndarray:
    """Halve the size in the page; single precision is far finer than a pixel."""
    return np.asarray(values, dtype=np.float32)
