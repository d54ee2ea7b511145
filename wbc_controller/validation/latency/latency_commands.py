"""Commands of `wbc bench`."""

import json
from pathlib import Path
from typing import Any

import click

from wbc_controller.nodes.signals import exit_by_signals
from wbc_controller.validation.latency import DOMAIN


@click.group()
def bench() -> None:
    """Measure the running controller on this computer."""
    exit_by_signals()


@bench.command()
@click.argument("robot", default="g1")
@click.option("--rate", type=float, help="States and cycles per second; by default as configured.")
@click.option("--seconds", default=60.0, show_default=True, help="Duration for the controller and for the echo, s.")
@click.option("--transport", default="dds", show_default=True, help="dds (`wbc run`), or rclpy (the ROS 2 nodes).")
@click.option("--mock", is_flag=True, help="Use the mock robot with its physics instead of a source of states.")
@click.option("--domain", default=DOMAIN, show_default=True, help="DDS domain of the processes.")
@click.option("--out", "folder", type=click.Path(path_type=Path), default=Path("bench"), show_default=True,
              help="Folder of the results and logs.")  # fmt: skip
def latency(robot: str, seconds: float, transport: str, mock: bool, folder: Path, **options: Any) -> None:
    """Measure the time from joint state to torques, and compare it with a bare echo.

    A state without torques within its period is late. Do not use the computer during the measurement.
    """
    from wbc_controller.validation.latency.latency import figures, lines, measure_latency

    found = measure_latency(
        robot,
        folder,
        seconds=seconds,
        transport=transport,
        mock=mock,
        **options,
        progress=lambda done, ours, bare: click.echo(
            f"{done:.0f} of {seconds:g} s: {1e6 * ours.quantiles[0]:.0f} us median, echo "
            f"{1e6 * bare.quantiles[0]:.0f}; {ours.late} of {ours.seconds.size} late",
            err=True,
        ),
    )
    (folder / "latency.json").write_text(json.dumps(figures(found), indent=2) + "\n", encoding="utf-8")
    driver = "the mock robot" if mock else "a source of states"
    click.echo(f"{robot} over {transport}, {seconds:g} s with {driver}, {seconds:g} s with an echo")
    for line in lines(found):
        click.echo(line)
