"""Tables for terminals and notebooks."""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from rich import box
from rich.console import Console
from rich.table import Table as RichTable


@dataclass(frozen=True, slots=True)
class Table:
    """Table of strings."""

    columns: tuple[str, ...]  # headings; first column left-aligned, others right-aligned
    rows: tuple[tuple[str, ...], ...]  # cells, each as long as `columns`


def as_text(heading: str, tables: Sequence[Table]) -> str:
    """Format a heading and non-empty tables for a terminal."""
    out = io.StringIO()
    console = Console(file=out, width=110, color_system=None, soft_wrap=True, force_jupyter=False)
    console.print(heading, markup=False, highlight=False)
    for table in tables:
        if table.rows:
            made = RichTable(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
            for i, column in enumerate(table.columns):
                made.add_column(column, justify="right" if i else "left", overflow="fold")
            for row in table.rows:
                made.add_row(*row)
            console.print()
            console.print(made, markup=False, highlight=False)
    return "\n".join(line.rstrip() for line in out.getvalue().splitlines())


def as_html(heading: str, tables: Sequence[Table]) -> str:
    """Format a heading and non-empty tables as HTML for a notebook."""
    parts = [f"<p>{escape(heading)}</p>"]
    for table in tables:
        if table.rows:
            head = "".join(f"<th{_side(i)}>{escape(column)}</th>" for i, column in enumerate(table.columns))
            rows = ("".join(f"<td{_side(i)}>{escape(cell)}</td>" for i, cell in enumerate(row)) for row in table.rows)
            body = "".join(f"<tr>{row}</tr>" for row in rows)
            parts.append(f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>")
    return "".join(parts)


def _side(column: int) -> str:
    return f' style="text-align:{"right" if column else "left"}"'
