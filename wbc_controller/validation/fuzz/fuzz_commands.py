"""Commands of `wbc fuzz`."""

import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from wbc_controller.nodes.signals import exit_by_signals
from wbc_controller.validation.fuzz import DOMAIN

F = TypeVar("F", bound=Callable[..., Any])

_EVERY = 10.0  # time between two progress lines, s


@click.group()
def fuzz() -> None:
    """Test with hostile messages, files, clocks, states and setpoints, floods, killed processes, and long runs.

    Floods, kills and soak start processes in their own DDS domain. The seed reproduces a run. Exit status 1: a test
    failed.
    """
    exit_by_signals()
    # Cache folder of Hypothesis, by default in the current folder.
    os.environ.setdefault(
        "HYPOTHESIS_STORAGE_DIRECTORY", str(Path(tempfile.gettempdir()) / "wbc_controller_hypothesis")
    )


def _options(*options: Callable[[Any], Any]) -> Callable[[F], F]:
    def add(function: F) -> F:
        for option in reversed(options):
            function = option(function)
        return function

    return add


_seed = click.option("--seed", default=0, show_default=True, help="Seed of all random choices.")
_common = _options(_seed, click.option("--out", "folder", type=click.Path(path_type=Path), default=Path("fuzz"),
                                       show_default=True, help="Folder of failures and logs."))  # fmt: skip
_live = _options(
    click.option("--domain", default=DOMAIN, show_default=True, help="DDS domain of the processes."), _common
)
_of_files = _options(
    click.argument("robots", default="go2,g1,talos"),
    click.option("--count", default=20_000, show_default=True, help="Number of files."),
    click.option("--first", default=0, show_default=True, help="Number of the first file."),
    _common,
)


@fuzz.command()
@click.argument("robot", default="go2")
@click.option("--count", default=1_000_000, show_default=True, help="Total number of messages.")
@click.option("--nodes", default="controller,guard,mock,urdf,estimator", show_default=True, help="Nodes under test.")
@click.option("--first", default=0, show_default=True, help="Number of the first episode of each node.")
@click.option("--replay", type=click.Path(path_type=Path), help="Only send the messages of a failure again.")
@_common
def messages(robot: str, count: int, nodes: str, first: int, replay: Path | None, seed: int, folder: Path) -> None:
    """Send hostile messages to every input of every node, in memory, and check the invariants."""
    from wbc_controller.validation.fuzz import hostile_messages as run

    if replay is not None:
        key, robot, sent = run.load(replay)
        why = run.replay(key, robot, sent)
        click.echo(f"{key}, {len(sent)} messages: {why or 'no failure'}")
        sys.exit(0 if why is None else 1)
    report = _Progress()
    outcome = run.fuzz_messages(
        robot,
        count,
        seed,
        first=first,
        targets=tuple(nodes.split(",")),
        progress=lambda outcome, key, episode: report(
            f"{outcome.sent} messages, {outcome.sent / max(outcome.seconds, 1e-9):.0f}/s, {len(outcome.failures)} "
            f"failures; {key}, episode {episode}"
        ),
    )
    for kind, of_kind in sorted(outcome.counts.items()):
        click.echo(f"{of_kind:9d}  {kind}")
    click.echo(
        f"{outcome.sent} messages in {outcome.seconds:.0f} s, {outcome.processor:.0f} s of processor time; memory "
        f"growth {outcome.growth / 1024:.0f} MB after the first {100 * run.WARM_UP:.0f} %"
    )
    for number, failure in enumerate(outcome.failures):
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{failure.target}-{seed}-{number}.json"
        run.save(failure, robot, path)
        note = "" if failure.repeated else " (not reproduced)"
        click.echo(f"{failure.target}, {len(failure.messages)} messages{note}: {failure.why[:500]}\n  --replay {path}")
    sys.exit(0 if not outcome.failures and outcome.flat else 1)


def _files(kind: str, robots: str, count: int, first: int, seed: int, folder: Path) -> None:
    from wbc_controller.validation.fuzz.files import fuzz_files

    report = _Progress()
    outcome = fuzz_files(
        kind,
        tuple(robots.split(",")),
        count,
        seed,
        folder,
        first=first,
        progress=lambda outcome, number: report(f"case {number}: {dict(outcome.results)}"),
    )
    done = sum(outcome.results.values())
    click.echo(f"{done} cases in {outcome.seconds:.0f} s: " + ", ".join(f"{n} {r}" for r, n in outcome.results.items()))
    for place, why in outcome.failures.items():
        click.echo(f"{place}: {why}")
    sys.exit(1 if outcome.failures else 0)


@fuzz.command()
@_of_files
def configurations(**options: Any) -> None:
    """Read hostile configuration files."""
    _files("configurations", **options)


@fuzz.command()
@_of_files
def urdf(**options: Any) -> None:
    """Read hostile URDFs."""
    _files("urdf", **options)


@fuzz.command()
@_of_files
def recordings(**options: Any) -> None:
    """Read hostile recordings with valid checksums."""
    _files("recordings", **options)


@fuzz.command()
@click.option("--count", default=5_000, show_default=True, help="Number of classes.")
@_seed
def classes(count: int, seed: int) -> None:
    """Run controllers with a user class with a hostile member: it is refused, or the robot is damped."""
    from wbc_controller.validation.fuzz.hostile_classes import fuzz_classes

    report = _Progress()
    failures, results = fuzz_classes(count, seed, lambda results, number: report(f"class {number}: {dict(results)}"))
    click.echo(", ".join(f"{number} {result}" for result, number in results.most_common()))
    for hostile, why in failures:
        click.echo(f"{hostile}: {why}")
    sys.exit(1 if failures else 0)


@fuzz.command()
@click.argument("robot", default="go2")
@click.option("--trials", default=100, show_default=True, help="Emergency stops per flood.")
@click.option("--kinds", help="Floods, comma-separated; by default all.")
@_live
def floods(robot: str, trials: int, kinds: str | None, domain: int, seed: int, folder: Path) -> None:
    """Flood each kind of input, and check that an emergency stop passes and the loop continues."""
    from wbc_controller.validation.fuzz import floods as run

    done = run.flood_trials(
        robot,
        folder,
        trials,
        kinds=tuple(kinds.split(",")) if kinds else tuple(run.FLOODS),
        domain=domain,
        seed=seed,
        progress=lambda trial: click.echo(str(trial), err=True),
    )
    for kind in dict.fromkeys(trial.flood for trial in done):
        of_kind = [trial for trial in done if trial.flood == kind]
        rates, cycles = [trial.rate for trial in of_kind], max(trial.cycles for trial in of_kind)
        delay, slowest = 1e3 * max(t.stop.delay for t in of_kind), 1e3 * max(t.slowest for t in of_kind)
        click.echo(
            f"{kind:14} at {min(rates):.0f} to {max(rates):.0f} messages/s: obeyed within {run.CYCLES} cycles in "
            f"{sum(t.obeyed for t in of_kind)} of {len(of_kind)} (max. {cycles}), zero torques within {delay:.1f} ms; "
            f"slowest cycle {slowest:.1f} ms, steady in {sum(t.steady for t in of_kind)}; losses reported in "
            f"{sum(t.stop.losses_reported for t in of_kind)}"
        )
    sys.exit(0 if all(trial.obeyed and trial.steady for trial in done) else 1)


@fuzz.command()
@click.argument("robot", default="go2")
@click.option("--trials", default=50, show_default=True, help="Trials per process and signal.")
@_live
def kills(robot: str, trials: int, domain: int, seed: int, folder: Path) -> None:
    """Kill, hang up and stop the controller and the mock robot at random times."""
    from wbc_controller.validation.fuzz import kills as run

    done = run.kill_trials(
        robot, folder, trials, domain=domain, seed=seed, progress=lambda trial: click.echo(str(trial), err=True)
    )
    for victim, method in dict.fromkeys((trial.victim, trial.method) for trial in done):
        of_kind = [trial for trial in done if (trial.victim, trial.method) == (victim, method)]
        gaps = sorted(1e3 * trial.gap for trial in of_kind)
        click.echo(
            f"{victim:10} {method:8} passed {sum(t.passed for t in of_kind)} of {len(of_kind)}; constant torques for a "
            f"median of {gaps[len(gaps) // 2]:.1f} ms, maximum {gaps[-1]:.1f} (allowed "
            f"{1e3 * of_kind[0].bound:.0f}, lateness of the machine {1e3 * max(t.late for t in of_kind):.0f})"
        )
    sys.exit(0 if all(trial.passed for trial in done) else 1)


@fuzz.command()
@click.argument("robot", default="go2")
@click.option("--minutes", default=30.0, show_default=True, help="Duration.")
@_live
def soak(robot: str, minutes: float, domain: int, seed: int, folder: Path) -> None:
    """Run controller, mock robot and guard for a long time, and monitor memory and faults."""
    from wbc_controller.validation.fuzz import soak as run

    report = _Progress()
    result = run.soak(
        robot,
        folder,
        60.0 * minutes,
        domain=domain,
        progress=lambda r: report(f"{r.seconds:.0f} s, {r.rate:.0f} commands/s, {len(r.faults)} faults"),
    )
    for name, values in result.memory.items():
        click.echo(
            f"{name:10} {values[0] / 1024:.0f} MB at the start, {values[-1] / 1024:.0f} MB at the end; growth "
            f"{result.growth(name)} kB in the second half{'' if result.flat(name) else ': TOO LARGE'}"
        )
    click.echo(
        f"{result.seconds:.0f} s, {result.rate:.1f} commands/s, lateness of the machine {1e3 * result.late:.0f} ms; "
        f"{len(result.faults)} faults, {len(result.own_faults)} not caused by the machine"
    )
    for fault_text in result.own_faults:
        click.echo(f"  {fault_text}")
    sys.exit(0 if not result.own_faults and all(result.flat(name) for name in result.memory) else 1)


@fuzz.command()
@click.argument("robots", default="go2,g1,talos")
@click.option("--count", default=1000, show_default=True, help="Trials per robot.")
@click.option("--first", default=0, show_default=True, help="Number of the first trial.")
@click.option("--seed", default=0, show_default=True, help="Seed of all random choices.")
def clocks(robots: str, count: int, first: int, seed: int) -> None:
    """Change clocks, stamps and delivery, pause the controller, and check that no robot falls without a fault."""
    from wbc_controller.validation.fuzz import clocks as run

    report = _Progress()
    done = run.fuzz_clocks(robots.split(","), count, seed, first=first, progress=lambda trial: report(trial.line()))
    for line in run.summary(done):
        click.echo(line)
    sys.exit(1 if any(trial.why for trial in done) else 0)


@fuzz.command()
@click.argument("robots", default="go2,g1,talos")
@click.option("--minutes", default=10.0, show_default=True, help="Simulated time under control per robot.")
@click.option("--first", default=0, show_default=True, help="Number of the first trial.")
@click.option("--seed", default=0, show_default=True, help="Seed of all random choices.")
def setpoints(robots: str, minutes: float, first: int, seed: int) -> None:
    """Send infeasible setpoints, and check that joints keep their limits under any relaxation."""
    from wbc_controller.validation.fuzz import setpoints as run

    report = _Progress()
    done = run.fuzz_setpoints(
        robots.split(","),
        minutes,
        seed,
        first=first,
        progress=lambda trial: report(
            f"{trial.robot}, trial {trial.number}: {trial.kind}, {trial.ended or 'active'} after {trial.seconds:.1f} s"
        ),
    )
    for line in run.summary(done):
        click.echo(line)
    sys.exit(0 if all(trial.within_limits for trial in done) else 1)


@fuzz.command()
@click.argument("robots", default="go2,g1,talos")
@click.option("--count", default=10_000, show_default=True, help="Problems per robot.")
@click.option("--first", default=0, show_default=True, help="Number of the first problem.")
@click.option("--seed", default=0, show_default=True, help="Offset of the problem numbers.")
def problems(robots: str, count: int, first: int, seed: int) -> None:
    """Solve random quadratic programs, and check by linear programs that nothing is relaxed unnecessarily."""
    from wbc_controller.validation.fuzz.problems import fuzz_problems

    report, failed = _Progress(), False
    for outcome in fuzz_problems(
        robots.split(","), count, seed, first=first, progress=lambda outcome: report(outcome.line())
    ):
        click.echo(outcome.line())
        for number, why in outcome.failures.items():
            click.echo(f"  problem {number}: {why}")
        failed = failed or bool(outcome.failures)
    sys.exit(1 if failed else 0)


class _Progress:
    def __init__(self) -> None:
        self._due = time.monotonic() + _EVERY

    def __call__(self, line: str) -> None:
        if time.monotonic() >= self._due:
            self._due = time.monotonic() + _EVERY
            click.echo(line, err=True)
