"""The command `wbc faults`."""

import sys
from pathlib import Path
from typing import Any

import click

from wbc_controller.apps.terminal.command_options import jobs_option


@click.command()
@click.argument("robots", nargs=-1, metavar="[ROBOT]...")
@click.option("--kinds", default="", help="Kinds of fault, comma-separated (docs/faults.md); by default all.")
@click.option("--seeds", default=25, show_default=True, type=click.IntRange(1), help="Trials per kind and robot.")
@click.option("--seed", type=click.IntRange(0), help="Run one trial per kind and robot with this seed.")
@click.option("--walking", is_flag=True, help="Faults during the steps of walking robots, by default g1 and talos.")
@jobs_option("trials")
@click.option("--out", "folder", type=click.Path(path_type=Path), default=Path("faults"), show_default=True,
              help="Folder of the results; only missing trials are run.")  # fmt: skip
@click.option("--backend", default="loky", show_default=True, help="loky (this machine), dask or ray.")
@click.option("--address", help="Address of the dask scheduler or the ray cluster.")
@click.option("--recordings", type=click.Path(path_type=Path, file_okay=False),
              help="Folder of the fault recordings. Each must name its fault, and its replay must be identical in each "
              "bit. Existing trials are not recorded.")  # fmt: skip
def faults(robots: tuple[str, ...], kinds: str, seeds: int, seed: int | None, walking: bool, **options: Any) -> None:
    """Run a fault campaign on mock robots, by default standing g1, talos and go2.

    Exit status 1: a trial violated a guarantee.
    """
    from wbc_controller.validation.campaign.run import run_campaign

    usual = ("g1", "talos") if walking else ("g1", "talos", "go2")
    named = [kind.strip() for kind in kinds.split(",") if kind.strip()]
    numbers = range(seeds) if seed is None else (seed,)
    sys.exit(0 if run_campaign(robots or usual, named, numbers, walking=walking, **options) else 1)
