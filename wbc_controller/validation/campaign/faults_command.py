"""The command `wbc faults`."""

import sys
from pathlib import Path

import click


@click.command()
@click.argument("robots", nargs=-1, metavar="[ROBOT]...")
@click.option("--kinds", default="", help="Kinds of fault, separated by commas: docs/faults.md; all by default.")
@click.option("--seeds", default=25, show_default=True, type=click.IntRange(1), help="Trials per kind and robot.")
@click.option("--seed", type=click.IntRange(0), help="One trial per kind and robot, with this seed, to repeat it.")
@click.option("--jobs", default=-1, show_default=True, help="Trials at once; -1 for one per processor.")
@click.option("--out", "folder", type=click.Path(path_type=Path), default=Path("faults"), show_default=True,
              help="Folder of the results; what is missing there is run.")  # fmt: skip
@click.option("--backend", default="loky", show_default=True, help="loky (this machine), dask or ray.")
@click.option("--address", help="Address of the dask scheduler or the ray cluster.")
@click.option("--recordings", type=click.Path(path_type=Path, file_okay=False),
              help="Folder for the recordings that faults leave: each has to name its fault, and to come out bit for "
              "bit. Trials that are in the results already are not recorded.")  # fmt: skip
def faults(
    robots: tuple[str, ...],
    kinds: str,
    seeds: int,
    seed: int | None,
    jobs: int,
    folder: Path,
    backend: str,
    address: str | None,
    recordings: Path | None,
) -> None:
    """Run a campaign of faults on mock robots, and report the outcomes: g1, talos and go2 by default.

    The status is 1 if a trial violates a guarantee.
    """
    from wbc_controller.validation.campaign.run import run_campaign

    good = run_campaign(
        robots or ("g1", "talos", "go2"),
        [kind.strip() for kind in kinds.split(",") if kind.strip()],
        range(seeds) if seed is None else (seed,),
        folder,
        jobs=jobs,
        backend=backend,
        address=address,
        recordings=recordings,
    )
    sys.exit(0 if good else 1)
