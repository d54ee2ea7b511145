"""The commands `wbc replay` and `wbc report`."""

import sys
from pathlib import Path

import click

from wbc_controller.errors import ConfigurationError
from wbc_controller.extras import require_libraries

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
    from wbc_controller.recording.replay.cycle_replay import Comparison
    from wbc_controller.recording.replay.recording_summary import replay_all, replay_cycle, summarize
    from wbc_controller.settings.config import load

    if plot is not None and other is None:
        raise ConfigurationError("--plot draws a comparison and requires --config")
    if plot is not None:
        require_libraries("plotly")
    recorded = Recording(file)
    if other is not None:
        comparison = Comparison(recorded, load(other))
        click.echo(str(comparison))
        if plot is not None:
            comparison.plot(plot, f"{recorded.path.name}: as recorded, and with {other}")
            click.echo(f"plots: {plot}")
    elif number is not None:
        click.echo(replay_cycle(recorded, number))
    else:
        click.echo(summarize(recorded))
        if not only_tell:
            text, good = replay_all(recorded)
            click.echo(f"\n{text}")
            sys.exit(0 if good else DIFFERENT)


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
