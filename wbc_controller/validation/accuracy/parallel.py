"""Common options, parallel execution, and tables."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar, get_args

import click

from wbc_controller.apps.terminal.command_options import jobs_option, with_options
from wbc_controller.nodes.processes import end_with_parent
from wbc_controller.settings.service import SensorQuality

T = TypeVar("T")

common_options = with_options(
    click.argument("robots", nargs=-1, metavar="[ROBOT]..."),
    click.option("--sensors", type=click.Choice(get_args(SensorQuality)), default="good", show_default=True,
                 help="Quality of the mock robot's sensors."),
    jobs_option("robots"),
)  # fmt: skip


def run_parallel(function: Callable[..., T], calls: Iterable[Sequence[Any]], jobs: int) -> list[T]:
    """Return the results of a function for several arguments."""
    import joblib

    parallel = joblib.Parallel(jobs, "loky", initializer=end_with_parent)
    found: list[T] = parallel(joblib.delayed(function)(*call) for call in calls)
    return found


def print_header(*columns: str) -> None:
    """Print the head of a Markdown table."""
    print_row(*columns)
    click.echo("|" + "---|" * len(columns))


def print_row(*cells: object) -> None:
    """Print a row of a Markdown table."""
    click.echo("|" + "|".join(f" {cell} " if str(cell) else " " for cell in cells) + "|")
