"""The commands `wbc replay` and `wbc report`."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from wbc_controller.errors import ConfigurationError
from wbc_controller.extras import require_libraries

if TYPE_CHECKING:
    from wbc_controller.recording.recording_file import Recording

DIFFERENT = 1  # exit status if a cycle differs from the recording

_FILE = click.argument("file", metavar="FILE", type=click.Path(path_type=Path, exists=True, dir_okay=False))


@click.command()
@_FILE
@click.option("--cycle", "number", type=click.IntRange(0), help="Replay this cycle and explain its result.")
@click.option("--config", "other", metavar="OTHER", help="Compare with this configuration: a robot's name or a file.")
@click.option("--plot", type=click.Path(path_type=Path, dir_okay=False),
              help="With --config: write the comparison over time to this .html file.")  # fmt: skip
@click.option("--only-tell", is_flag=True, help="Summarize the recording without a replay.")
def replay(file: Path, number: int | None, other: str | None, plot: Path | None, only_tell: bool) -> None:
    """Summarize a recording, list its faults, and replay its cycles: docs/recording.md.

    The exit status is 1 if a cycle differs that must be equal bit for bit.
    """
    from wbc_controller.recording.recording_file import Recording
    from wbc_controller.recording.replay.recording_summary import summarize

    if plot is not None and other is None:
        raise ConfigurationError("--plot draws a comparison and requires --config")
    if plot is not None:
        require_libraries("plotly")
    recorded = Recording(file)
    if other is not None:
        _compare(recorded, other, plot)
    elif number is not None:
        _explain(recorded, number)
    else:
        click.echo(summarize(recorded))
        if not only_tell:
            sys.exit(_solve(recorded))


@click.command()
@_FILE
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False),
              help="The .html file; by default FILE with this ending.")  # fmt: skip
def report(file: Path, out: Path | None) -> None:
    """Make a report of a recording, as of the demo, with true contact forces if recorded."""
    from wbc_controller.recording.recording_file import Recording
    from wbc_controller.recording.report.run_report import report_recording

    require_libraries("plotly")
    path = file.with_suffix(".html") if out is None else out
    notes = report_recording(Recording(file), path)
    if notes:
        click.echo(notes)
    click.echo(f"report: {path}")


def _solve(recorded: "Recording") -> int:
    from wbc_controller.recording.replay.cycle_replay import Replay

    run = Replay(recorded)
    count, different, worst, exact = 0, 0, 0.0, True
    first = ""
    for solved in run.run():
        count += 1
        if not solved.is_identical:
            different += 1
            worst, exact = max(worst, solved.difference), exact and not solved.exact
            first = first or f"the first is cycle {solved.cycle.number} at {recorded.elapsed(solved.cycle.time):.3f} s"
    click.echo()
    if run.skipped:
        click.echo(
            f"{run.skipped} cycles skipped: their requests or the controller's memory before them are not recorded"
        )
    if not different:
        click.echo(f"{count} cycles replayed: all torques are equal bit for bit")
        return 0 if count else DIFFERENT
    reason = "" if not exact else " (the solver does not expose its warm start: only whole recordings are exact)"
    click.echo(f"{count} cycles replayed: {different} differ, by up to {worst:.3g} N·m; {first}{reason}")
    return 0 if exact else DIFFERENT


def _explain(recorded: "Recording", number: int) -> None:
    from wbc_controller.recording.replay.cycle_replay import Replay
    from wbc_controller.recording.replay.recording_summary import explain_cycle

    if not recorded.first <= number <= recorded.last:
        raise ConfigurationError(f"--cycle {number}: valid: {recorded.first} to {recorded.last}")
    run = Replay(recorded)
    for solved in run.run(number, number):
        if solved.cycle.number == number:
            click.echo(explain_cycle(solved, recorded, run.controller))
            return
    known = recorded.memory_after(number)
    raise ConfigurationError(
        f"--cycle {number}: the cycle or the controller's memory before it is not recorded; "
        + (f"valid: from {known} on" if known is not None else "no later cycle can be replayed")
    )


def _compare(recorded: "Recording", other: str, plot: Path | None) -> None:
    from wbc_controller.recording.replay.comparison import compare
    from wbc_controller.settings.config import load

    config = load(other)
    comparison = compare(recorded, config)
    click.echo(str(comparison))
    if plot is not None:
        comparison.plot(plot, f"{recorded.path.name}: as recorded, and with {other}")
        click.echo(f"plots: {plot}")
