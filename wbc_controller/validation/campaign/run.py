"""Execution of a campaign, on this machine or a cluster."""

import contextlib
import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from wbc_controller.errors import ConfigurationError, require_known
from wbc_controller.extras import optional_libraries
from wbc_controller.nodes.processes import end_with_parent
from wbc_controller.settings.files import find_configuration
from wbc_controller.validation.campaign import campaign_report
from wbc_controller.validation.campaign.results import Outcome, Results, TrialKey
from wbc_controller.validation.campaign.trial import ALL_KINDS, run_trial

BACKENDS = ("loky", "dask", "ray")
_WIDTH = 150  # outside a terminal, characters
_PROGRESS_EVERY = 100  # trials, outside a terminal


def run_campaign(
    robots: Sequence[str],
    kinds: Sequence[str],
    seeds: Sequence[int],
    folder: Path,
    *,
    walking: bool = False,
    jobs: int = 1,
    backend: str = "loky",
    address: str | None = None,
    recordings: Path | None = None,
    console: Console | None = None,
) -> bool:
    """Run the missing trials of a folder, and write the report; return True without violations.

    Args:
        jobs: -1 for one per processor.
        address: of the scheduler or cluster.

    Raises:
        ConfigurationError: if a name is unknown, a file cannot be used, or the backend is not installed.
    """
    console = console or (Console() if Console().is_terminal else Console(width=_WIDTH))
    for robot in robots:
        find_configuration(robot)
    require_known(kinds, ALL_KINDS, "unknown kind of fault")
    keys = [TrialKey(robot, kind, seed, walking) for seed in seeds for kind in kinds or ALL_KINDS for robot in robots]
    results = Results(folder)
    if results.other_versions:
        console.print(
            f"{results.path}: {results.other_versions} trials of another version of the code or the robot are ignored"
        )
    missing = [key for key in keys if key not in results.outcomes]
    if len(missing) < len(keys):
        console.print(f"{len(keys) - len(missing)} of {len(keys)} trials exist already")
    interrupted = False
    try:
        trial = partial(run_trial, recordings=recordings)
        with _parallel(jobs, backend, address, trial) as run, _progress(console, len(missing)) as done:
            for outcome in run(missing):
                results.add(outcome)
                done(outcome)
        for key in keys:
            if "stall" in results.outcomes[key].violations and key not in results.repeated:
                results.add(_in_new_process(key, trial))
    except KeyboardInterrupt:
        interrupted = True
        console.print(f"interrupted; the same command resumes the campaign in {results.path}")
    finally:
        results.close()
    outcomes = [results.outcomes[key] for key in keys if key in results.outcomes]
    if not outcomes:
        return not interrupted
    console.print(campaign_report.terminal_table(outcomes))
    console.print(campaign_report.summary(outcomes))
    repeated = campaign_report.repetitions(outcomes, results.repeated)
    for sentence in repeated:
        console.print(sentence, markup=False)
    console.print(f"report: {folder}/{campaign_report.write_report(outcomes, folder, repeated)}", markup=False)
    bad = campaign_report.worst_trial(outcomes)
    if bad is not None:
        console.print(f"worst trial: {bad.robot}, {bad.kind}, seed {bad.seed}: {bad.violations_text}", markup=False)
        console.print(f"repeat with: {campaign_report.repeat_command(bad)}", markup=False)
    return bad is None and not interrupted


def _in_new_process(key: TrialKey, trial: Callable[..., Outcome]) -> Outcome:
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(trial, *key).result()


@contextlib.contextmanager
def _parallel(jobs: int, backend: str, address: str | None, trial: Callable[..., Outcome]) -> Iterator[Any]:
    with optional_libraries():
        import joblib
    require_known(backend, BACKENDS, "unknown backend")
    local = backend == "loky"
    if local and address is not None:
        raise ConfigurationError(
            f"--address {address!r}: not valid for the backend loky (this machine); valid: dask, ray"
        )
    options = {"initializer": end_with_parent} if local else {}
    with _cluster(backend, address), joblib.parallel_config(backend, n_jobs=jobs, **options):
        # Single trials on this machine: each outcome is stored at once; a cluster returns batches.
        parallel = joblib.Parallel(return_as="generator_unordered", batch_size=1) if local else joblib.Parallel()

        def run(keys: Sequence[TrialKey]) -> Iterator[Outcome]:
            size = len(keys) or 1 if local else 10 * _PROGRESS_EVERY
            for i in range(0, len(keys), size):
                yield from parallel(joblib.delayed(trial)(*key) for key in keys[i : i + size])

        yield run


def _cluster(backend: str, address: str | None) -> contextlib.AbstractContextManager[Any]:
    try:
        if backend == "dask":
            from distributed import Client
        elif backend == "ray":
            import ray
            from ray.util.joblib import register_ray
    except ModuleNotFoundError as error:
        raise ConfigurationError(
            f"the backend {backend} is not installed ({error}); install it, or use loky"
        ) from error
    if backend == "dask":
        return Client(address)  # type: ignore[no-any-return]
    if backend == "ray":
        if not ray.is_initialized():
            ray.init(address=address)
        register_ray()
    return contextlib.nullcontext()


@contextlib.contextmanager
def _progress(console: Console, total: int) -> Iterator[Any]:
    """Yield a function that counts an outcome, and shows the counts in a bar or, outside a terminal, in lines."""
    count = {"survived": 0, "damped": 0, "violation": 0}
    bar = Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn(),
        console=console,
    )  # fmt: skip

    def progress_text() -> str:
        return ", ".join(f"{number} {result}" for result, number in count.items())

    def done(outcome: Outcome) -> None:
        count[outcome.result] += 1
        number = sum(count.values())
        bar.update(task, advance=1, description=progress_text())
        if not console.is_terminal and (number % _PROGRESS_EVERY == 0 or number == total):
            console.print(f"{number} of {total} trials: {progress_text()}")

    task = bar.add_task(progress_text(), total=total)
    with bar if console.is_terminal else contextlib.nullcontext():
        yield done
