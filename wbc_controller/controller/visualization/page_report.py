"""Reports as self-contained HTML pages."""

import importlib.resources
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

from wbc_controller.controller.visualization.plots import plotly_script
from wbc_controller.errors import ConfigurationError


@dataclass(frozen=True, slots=True, eq=False)
class Plot:
    """Plot of a page."""

    key: str  # id of the HTML element
    title: str
    caption: str  # explanation
    figure: Any
    over_time: bool = False  # True if the x axis is the time of the motion


@dataclass(frozen=True, slots=True)
class ResultTable:
    """Table of a page."""

    title: str
    columns: Sequence[str]  # headings; empty for none
    #: Cells, and True for a good row, False for a bad one, None for neither.
    rows: Sequence[tuple[Sequence[str], bool | None]]
    words: tuple[str, str] = ("met", "missed")  # words for a good and a bad row


@dataclass(frozen=True, slots=True)
class Drawing:
    """Drawing of a page."""

    title: str
    caption: str  # legend, HTML
    content: str  # HTML or SVG


@dataclass(frozen=True, slots=True, eq=False)
class PageReport:
    """Contents of a page. Absent parts are omitted."""

    title: str  # such as the name of the robot
    kind: str  # kind of the report, above the title
    verdict: str  # result in one sentence
    passed: bool | None = None  # True for a good result, False for a bad one, None for neither
    note: str = ""  # below the verdict
    facts: Mapping[str, str] = field(default_factory=dict)  # short values by name
    motion: Mapping[str, Any] | None = None  # input of ``replay.js``, or None
    drawing: Drawing | None = None
    table: ResultTable | None = None
    plots: Sequence[Plot] = ()
    footer: str = ""


def write_page(report: PageReport, path: Path) -> None:
    """Write a report as one HTML file; `ConfigurationError` if that fails, or plotly is missing for plots."""
    page = render(report)
    try:
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise ConfigurationError(f"report {path}: cannot be written: {error.strerror or error}") from error


def render(report: PageReport) -> str:
    """Return a report as an HTML page."""
    scripts = []
    if report.motion is not None:
        scripts.append(_data("motion-data", report.motion))
    if report.plots:
        scripts += [_data("plot-data", {plot.key: _figure_data(plot) for plot in report.plots}), plotly_script()]
    scripts += [resource("replay.js"), resource("page.js")]
    pieces = {
        "title": escape(f"{report.title}: {report.kind}"),
        "style": resource("report.css"),
        "header": _header(report),
        "top": _top(report),
        "plots": "\n".join(_figure(plot) for plot in report.plots),
        "footer": escape(report.footer),
        "scripts": "\n".join(part if part.startswith("<script") else f"<script>{part}</script>" for part in scripts),
    }
    # One pass: placeholders within pieces are not replaced.
    return re.sub(r"\{\{(\w+)\}\}", lambda match: pieces[match.group(1)], resource("report.html"))


def _header(report: PageReport) -> str:
    state = {True: " pass", False: " fail", None: ""}[report.passed]
    mark = '<span class="mark"></span>' if report.passed is not None else ""
    note = f"<p>{escape(report.note)}</p>" if report.note else ""
    facts = "".join(f"<div><dt>{escape(key)}</dt><dd>{escape(value)}</dd></div>" for key, value in report.facts.items())
    return (
        f'<div><p class="eyebrow">{escape(report.kind)}</p><h1>{escape(report.title)}</h1>'
        f'<p class="verdict{state}">{mark}{escape(report.verdict)}</p>{note}</div><dl class="facts">{facts}</dl>'
    )


def _top(report: PageReport) -> str:
    left = resource("motion.html") if report.motion is not None else ""
    if (drawing := report.drawing) is not None:
        left += f'<div class="card plan"><h2>{escape(drawing.title)}</h2><p>{drawing.caption}</p>'
        left += f"{drawing.content}</div>"
    right = _table(report.table) if report.table is not None else ""
    columns = "two" if left and right else "one"
    return f'<section class="top {columns}">{f"<div>{left}</div>" if left else ""}{right}</section>'


def _table(table: ResultTable) -> str:
    states = {True: ("pass", table.words[0]), False: ("fail", table.words[1])}
    columns = [*table.columns, ""] if any(passed is not None for _, passed in table.rows) else [*table.columns]
    head = "".join(f'<th scope="col">{escape(column)}</th>' for column in columns)
    rows = []
    for (name, *cells), passed in table.rows:
        row = f'<th scope="row">{escape(name)}</th>'
        row += "".join(
            f'<td data-label="{escape(column)}">{escape(cell)}</td>'
            for column, cell in zip(table.columns[1:] or [""] * len(cells), cells, strict=True)
        )
        if passed is not None:
            state, word = states[passed]
            row += f'<td><span class="pill {state}">{word}</span></td>'
        rows.append(f"<tr>{row}</tr>")
    return (
        f'<div class="card results"><h2>{escape(table.title)}</h2><table>'
        + (f"<thead><tr>{head}</tr></thead>" if table.columns else "")
        + f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def _figure(plot: Plot) -> str:
    width = "wide" if plot.over_time else "half"
    return (
        f'<figure class="card plot {width}" data-plot="{plot.key}" data-over-time="{str(plot.over_time).lower()}">'
        f"<figcaption><h2>{escape(plot.title)}</h2><p>{escape(plot.caption)}</p></figcaption>"
        '<div class="legend"></div><div class="phases" aria-hidden="true"></div>'
        f'<div class="chart" style="height:{plot.figure.layout.height}px"></div></figure>'
    )


def _figure_data(plot: Plot) -> Any:
    content = json.loads(plot.figure.to_json())
    content["layout"] |= {"template": None, "showlegend": False}
    return content


def _data(key: str, value: Any) -> str:
    """Return JSON in a script element; `</` is escaped."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False).replace("</", "<\\/")
    return f'<script type="application/json" id="{key}">{text}</script>'


def resource(name: str) -> str:
    """Read a file of the folder ``page``."""
    return (importlib.resources.files(__package__) / "page" / name).read_text(encoding="utf-8")
