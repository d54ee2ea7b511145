"""Runs a campaign: trials in parallel, on this machine or on a cluster."""

import contextlib
import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from wbc_controller.errors import ConfigurationError, valid_choices
from wbc_controller.settings.files import find_configuration
from wbc_controller.validation.campaign.campaign_report import (
    command_that_repeats,
    repetitions,
    summary,
    terminal_table,
    worst,
    write_report,
)
from wbc_controller.validation.campaign.outcome import Outcome
from wbc_controller.validation.campaign.results import Key, Results
from wbc_controller.validation.campaign.trial import ALL_KINDS, run_trial

BACKENDS = ("loky", "dask", "ray")
#: Width of the output where it is not a terminal, in characters.
_WIDTH = 150
#: Between two lines about progress where the output is no terminal, in trials.
_SAY_EVERY = 100


def run_campaign(
    robots: Sequence[str],
    kinds: Sequence[str],
    seeds: Sequence[int],
    folder: Path,
    *,
    jobs: int = 1,
    backend: str = "loky",
    address: str | None = None,
    recordings: Path | None = None,
    console: Console | None = None,
) -> bool:
    """Run the trials that are missing in a folder, and write the report of all.

    Args:
        folder: where the results are kept; a second call goes on where the first has ended.
        jobs: trials at once; -1 for as many as there are processors.
        address: of the scheduler or cluster of the backend, where it has one.
        recordings: folder for the recordings that faults leave, which are then looked at; None records nothing.

    Returns:
        Whether there was no violation.

    Raises:
        ConfigurationError: where a name is unknown, a file cannot be used, or the backend is not installed.
    """
    console = console or (Console() if Console().is_terminal else Console(width=_WIDTH))
    for robot in robots:
        find_configuration(robot)
    for kind in kinds:
        if kind not in ALL_KINDS:
            raise ConfigurationError(f"kind {kind!r} is unknown; {valid_choices(kind, ALL_KINDS)}")
    wanted = [Key(robot, kind, seed) for seed in seeds for kind in kinds or ALL_KINDS for robot in robots]
    results = Results(folder)
    if results.others:
        console.print(
            f"{results.path} has {results.others} trials of another version of the code or configuration: they are "
            "not used"
        )
    missing = [key for key in wanted if key not in results.outcomes]
    if len(missing) < len(wanted):
        console.print(f"{len(wanted) - len(missing)} of {len(wanted)} trials are there already")
    interrupted = False
    try:
        trial = partial(run_trial, recordings=recordings)
        with _parallel(jobs, backend, address, trial) as run, _progress(console, len(missing)) as done:
            for outcome in run(missing):
                results.add(outcome)
                done(outcome)
        _repeat_stalls(results, wanted, trial)
    except KeyboardInterrupt:
        interrupted = True
        console.print(f"interrupted; the same command goes on with what is missing in {results.path}")
    finally:
        results.close()
    outcomes = [results.outcomes[key] for key in wanted if key in results.outcomes]
    if not outcomes:
        return not interrupted
    console.print(terminal_table(outcomes))
    console.print(summary(outcomes))
    repeated = repetitions(outcomes, results.repeated)
    for sentence in repeated:
        console.print(sentence, markup=False)
    console.print(f"report: {folder}/{write_report(outcomes, folder, repeated)}", markup=False)
    bad = worst(outcomes)
    if bad is not None:
        names = "; ".join(f"{name}: {sentence}" for name, sentence in bad.violations.items())
        console.print(f"the worst trial: {bad.robot}, {bad.kind}, seed {bad.seed}: {names}", markup=False)
        console.print(f"repeat it with: {command_that_repeats(bad)}", markup=False)
    return bad is None and not interrupted


def _repeat_stalls(results: Results, wanted: Sequence[Key], trial: Callable[..., Outcome]) -> None:
    """Repeat the trials with stalls, each in a new process.

    A trial computes the same in every run, the first time of a process too. A host that halts a processor of a virtual
    machine, and a kernel that looks for memory, count as the thread's own processor time; they do not come again.
    """
    for key in wanted:
        if "stall" in results.outcomes[key].violations and key not in results.repeated:
            results.add(_in_new_process(key, trial))


def _in_new_process(key: Key, trial: Callable[..., Outcome]) -> Outcome:
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(trial, *key).result()


@contextlib.contextmanager
def _parallel(jobs: int, backend: str, address: str | None, trial: Callable[..., Outcome]) -> Iterator[Any]:
    """A function that runs trials and gives their outcomes as they come."""
    import joblib

    if backend not in BACKENDS:
        raise ConfigurationError(f"backend {backend!r} is unknown; {valid_choices(backend, BACKENDS)}")
    if backend == "loky" and address is not None:
        raise ConfigurationError(f"address {address!r}: the backend loky is this machine; dask and ray take an address")
    with _cluster(backend, address), joblib.parallel_config(backend, n_jobs=jobs):

        def run(keys: Sequence[Key]) -> Iterator[Outcome]:
            # One trial after the other goes out, so that what has been done is known, and can be kept, at any time.
            streamed = "generator_unordered" if backend == "loky" else "list"
            parallel = joblib.Parallel(return_as=streamed, batch_size=1 if backend == "loky" else "auto")
            # On a cluster the outcomes come in portions, each of which is kept when it is complete.
            size = len(keys) or 1 if backend == "loky" else 10 * _SAY_EVERY
            for i in range(0, len(keys), size):
                yield from parallel(joblib.delayed(trial)(*key) for key in keys[i : i + size])

        yield run


@contextlib.contextmanager
def _cluster(backend: str, address: str | None) -> Iterator[None]:
    """Connect to a cluster, where the backend is one."""
    if backend == "loky":
        yield
        return
    try:
        if backend == "dask":
            from distributed import Client

            with Client(address):
                yield
            return
        import ray
        from ray.util.joblib import register_ray
    except ModuleNotFoundError as error:
        raise ConfigurationError(f"the backend {backend} is not installed ({error}); Valid without: loky") from error
    if not ray.is_initialized():
        ray.init(address=address)
    register_ray()
    yield


@contextlib.contextmanager
def _progress(console: Console, total: int) -> Iterator[Any]:
    """A progress bar, or a line now and then where the output is not a terminal."""
    count = {"survived": 0, "damped": 0, "violation": 0}

    def said() -> str:
        return ", ".join(f"{number} {result}" for result, number in count.items())

    if not console.is_terminal:

        def line(outcome: Outcome) -> None:
            count[outcome.result] += 1
            if sum(count.values()) % _SAY_EVERY == 0 or sum(count.values()) == total:
                console.print(f"{sum(count.values())} of {total} trials: {said()}")

        yield line
        return
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=console) as progress:
        task = progress.add_task(said(), total=total)

        def advance(outcome: Outcome) -> None:
            count[outcome.result] += 1
            progress.update(task, advance=1, description=said())

        yield advance
