"""The commands of `wbc fuzz`, with their progress and final tables."""

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

#: Time between two lines of progress, s.
_EVERY = 10.0


@click.group()
def fuzz() -> None:
    """Try to break it: hostile messages, files, clocks, states and setpoints, floods, killed processes, long runs.

    Floods, kills and soak start real processes on a DDS domain of their own, the others none. All of them end with exit
    status 1 where something broke, and repeat themselves by their seed.
    """
    exit_by_signals()
    # Hypothesis keeps a cache there, by default in the current folder.
    os.environ.setdefault(
        "HYPOTHESIS_STORAGE_DIRECTORY", str(Path(tempfile.gettempdir()) / "wbc_controller_hypothesis")
    )


def _options(*options: Callable[[Any], Any]) -> Callable[[F], F]:
    """Combine options, in the order of the help text."""

    def add(function: F) -> F:
        for option in reversed(options):
            function = option(function)
        return function

    return add


_seed = click.option("--seed", default=0, show_default=True, help="Of all choices.")
#: Options of the commands that write files, of those with real processes, and of those that read files.
_common = _options(_seed, click.option("--out", "folder", type=click.Path(path_type=Path), default=Path("fuzz"),
                                       show_default=True, help="Folder for what broke, and for logs."))  # fmt: skip
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
@click.option("--count", default=1_000_000, show_default=True, help="Messages, over all nodes.")
@click.option("--nodes", default="controller,guard,mock,urdf,estimator", show_default=True, help="Nodes under test.")
@click.option("--first", default=0, show_default=True, help="Number of the first episode of each node.")
@click.option(
    "--replay", type=click.Path(path_type=Path), help="Send the messages of a failure again, and nothing else."
)
@_common
def messages(robot: str, count: int, nodes: str, first: int, replay: Path | None, seed: int, folder: Path) -> None:
    """Send hostile messages on every input of every node, in memory, and see what they change."""
    from wbc_controller.validation.fuzz import hostile_messages as run

    if replay is not None:
        key, robot, sent = run.load(replay)
        why = run.replay(key, robot, sent)
        click.echo(f"{key}, {len(sent)} messages: {why or 'nothing breaks'}")
        sys.exit(0 if why is None else 1)
    say = _Progress()
    outcome = run.fuzz_messages(
        robot,
        count,
        seed,
        first=first,
        targets=tuple(nodes.split(",")),
        progress=lambda outcome, key, episode: say(
            f"{outcome.sent} messages, {outcome.sent / max(outcome.seconds, 1e-9):.0f}/s, {len(outcome.failures)} "
            f"failures; {key}, episode {episode}"
        ),
    )
    for kind, of_kind in sorted(outcome.counts.items()):
        click.echo(f"{of_kind:9d}  {kind}")
    click.echo(
        f"{outcome.sent} messages in {outcome.seconds:.0f} s, {outcome.processor:.0f} s of processor time; memory grew "
        f"by {outcome.growth / 1024:.0f} MB after the first {100 * run.WARM_UP:.0f} %"
    )
    for number, failure in enumerate(outcome.failures):
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{failure.target}-{seed}-{number}.json"
        run.save(failure, robot, path)
        again = "" if failure.repeated else " (not again, when they were sent once more)"
        click.echo(f"{failure.target}, {len(failure.messages)} messages{again}: {failure.why[:500]}\n  --replay {path}")
    sys.exit(0 if not outcome.failures and outcome.flat else 1)


def _files(kind: str, robots: str, count: int, first: int, seed: int, folder: Path) -> None:
    from wbc_controller.validation.fuzz.files import fuzz_files

    say = _Progress()
    outcome = fuzz_files(
        kind,
        tuple(robots.split(",")),
        count,
        seed,
        folder,
        first=first,
        progress=lambda outcome, number: say(f"case {number}: {dict(outcome.results)}"),
    )
    done = sum(outcome.results.values())
    click.echo(f"{done} cases in {outcome.seconds:.0f} s: " + ", ".join(f"{n} {r}" for r, n in outcome.results.items()))
    for place, why in outcome.failures.items():
        click.echo(f"{place}: {why}")
    sys.exit(1 if outcome.failures else 0)


@fuzz.command()
@_of_files
def configurations(**options: Any) -> None:
    """Read hostile configuration files: each works, or is refused in a sentence with its path."""
    _files("configurations", **options)


@fuzz.command()
@_of_files
def urdf(**options: Any) -> None:
    """Read hostile URDFs: each works, or is refused in a sentence with the path of its configuration."""
    _files("urdf", **options)


@fuzz.command()
@_of_files
def recordings(**options: Any) -> None:
    """Read hostile recordings with valid checksums: each works, or is refused in a sentence with its path."""
    _files("recordings", **options)


@fuzz.command()
@click.option("--count", default=5_000, show_default=True, help="Number of classes.")
@_seed
def classes(count: int, seed: int) -> None:
    """Run controllers with a user's class that has a hostile member: it is refused, or the robot is damped."""
    from wbc_controller.validation.fuzz.hostile_classes import fuzz_classes

    say = _Progress()
    failures, results = fuzz_classes(count, seed, lambda results, number: say(f"class {number}: {dict(results)}"))
    click.echo(", ".join(f"{number} {result}" for result, number in results.most_common()))
    for hostile, why in failures:
        click.echo(f"{hostile}: {why}")
    sys.exit(1 if failures else 0)


@fuzz.command()
@click.argument("robot", default="go2")
@click.option("--trials", default=100, show_default=True, help="Emergency stops under each flood.")
@click.option("--kinds", help="Floods; all of them where none is named.")
@_live
def floods(robot: str, trials: int, kinds: str | None, domain: int, seed: int, folder: Path) -> None:
    """Flood each kind of input, and see that an emergency stop passes, and that the loop goes on."""
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
        seen, slowest = 1e3 * max(t.stop.seen for t in of_kind), 1e3 * max(t.slowest for t in of_kind)
        click.echo(
            f"{kind:14} at {min(rates):.0f} to {max(rates):.0f} messages/s: obeyed within {run.CYCLES} cycles in "
            f"{sum(t.obeyed for t in of_kind)} of {len(of_kind)} (at most {cycles}), seen after {seen:.1f} ms at most; "
            f"slowest cycle {slowest:.1f} ms, steady in {sum(t.steady for t in of_kind)}; losses said in "
            f"{sum(t.stop.said for t in of_kind)}"
        )
    sys.exit(0 if all(trial.obeyed and trial.steady for trial in done) else 1)


@fuzz.command()
@click.argument("robot", default="go2")
@click.option("--trials", default=50, show_default=True, help="Trials of each process in each way.")
@_live
def kills(robot: str, trials: int, domain: int, seed: int, folder: Path) -> None:
    """Kill, hang up and stop the controller and the mock robot at random moments."""
    from wbc_controller.validation.fuzz import kills as run

    done = run.kill_trials(
        robot, folder, trials, domain=domain, seed=seed, progress=lambda trial: click.echo(str(trial), err=True)
    )
    for victim, way in dict.fromkeys((trial.victim, trial.way) for trial in done):
        of_kind = [trial for trial in done if (trial.victim, trial.way) == (victim, way)]
        gaps = sorted(1e3 * trial.gap for trial in of_kind)
        click.echo(
            f"{victim:10} {way:8} held in {sum(t.held for t in of_kind)} of {len(of_kind)}; torques stayed for "
            f"{gaps[len(gaps) // 2]:.1f} ms in the median, {gaps[-1]:.1f} at most (allowed "
            f"{1e3 * of_kind[0].bound:.0f}, machine late by up to {1e3 * max(t.late for t in of_kind):.0f})"
        )
    sys.exit(0 if all(trial.held for trial in done) else 1)


@fuzz.command()
@click.argument("robot", default="go2")
@click.option("--minutes", default=30.0, show_default=True, help="Duration.")
@_live
def soak(robot: str, minutes: float, domain: int, seed: int, folder: Path) -> None:
    """Run controller, mock robot and guard for long, and watch their memory and faults."""
    from wbc_controller.validation.fuzz import soak as run

    say = _Progress()
    result = run.soak(
        robot,
        folder,
        60.0 * minutes,
        domain=domain,
        progress=lambda r: say(f"{r.seconds:.0f} s, {r.rate:.0f} commands/s, {len(r.faults)} faults"),
    )
    for name, kept in result.memory.items():
        click.echo(
            f"{name:10} {kept[0] / 1024:.0f} MB at the start, {kept[-1] / 1024:.0f} MB at the end; grew by "
            f"{result.growth(name)} kB in the second half{'' if result.flat(name) else ': NOT FLAT'}"
        )
    click.echo(
        f"{result.seconds:.0f} s, {result.rate:.1f} commands/s, machine late by up to {1e3 * result.late:.0f} ms; "
        f"{len(result.faults)} faults, of which the machine did not cause {len(result.own_faults)}"
    )
    for said in result.own_faults:
        click.echo(f"  {said}")
    sys.exit(0 if not result.own_faults and all(result.flat(name) for name in result.memory) else 1)


@fuzz.command()
@click.argument("robots", default="go2,g1,talos")
@click.option("--count", default=1000, show_default=True, help="Trials of each robot.")
@click.option("--first", default=0, show_default=True, help="Number of each robot's first trial.")
@click.option("--seed", default=0, show_default=True, help="Of all choices.")
def clocks(robots: str, count: int, first: int, seed: int) -> None:
    """Change clocks, stamps and delivery, pause the controller, and see that no robot falls without a fault."""
    from wbc_controller.validation.fuzz import clocks as run

    say = _Progress()
    done = run.fuzz_clocks(robots.split(","), count, seed, first=first, progress=lambda trial: say(trial.line()))
    for line in run.summary(done):
        click.echo(line)
    sys.exit(1 if any(trial.why for trial in done) else 0)


@fuzz.command()
@click.argument("robots", default="go2,g1,talos")
@click.option("--minutes", default=10.0, show_default=True, help="Simulated time under control, for each robot.")
@click.option("--first", default=0, show_default=True, help="Number of each robot's first trial.")
@click.option("--seed", default=0, show_default=True, help="Of all choices.")
def setpoints(robots: str, minutes: float, first: int, seed: int) -> None:
    """Ask for what no robot can do, and see that its joints keep their limits, whatever is relaxed."""
    from wbc_controller.validation.fuzz import setpoints as run

    say = _Progress()
    done = run.fuzz_setpoints(
        robots.split(","),
        minutes,
        seed,
        first=first,
        progress=lambda trial: say(
            f"{trial.robot}, trial {trial.number}: {trial.kind}, {trial.ended or 'active'} after {trial.seconds:.1f} s"
        ),
    )
    for line in run.summary(done):
        click.echo(line)
    sys.exit(0 if all(trial.kept for trial in done) else 1)


@fuzz.command()
@click.argument("robots", default="go2,g1,talos")
@click.option("--count", default=10_000, show_default=True, help="Problems of each robot.")
@click.option("--first", default=0, show_default=True, help="Number of the first problem.")
@click.option("--seed", default=0, show_default=True, help="Added to the number of each problem.")
def problems(robots: str, count: int, first: int, seed: int) -> None:
    """Solve random quadratic programs, and see by linear programs that nothing is relaxed without need."""
    from wbc_controller.validation.fuzz.problems import fuzz_problems

    say, failed = _Progress(), False
    for outcome in fuzz_problems(
        robots.split(","), count, seed, first=first, progress=lambda outcome: say(outcome.line())
    ):
        click.echo(outcome.line())
        for number, why in outcome.failures.items():
            click.echo(f"  problem {number}: {why}")
        failed = failed or bool(outcome.failures)
    sys.exit(1 if failed else 0)


class _Progress:
    """Writes a line now and then."""

    def __init__(self) -> None:
        self._due = time.monotonic() + _EVERY

    def __call__(self, line: str) -> None:
        if time.monotonic() >= self._due:
            self._due = time.monotonic() + _EVERY
            click.echo(line, err=True)
