"""Commands of `wbc fuzz`."""

import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click

from wbc_controller.apps.terminal.command_options import F, with_options
from wbc_controller.nodes.signals import exit_by_signals

_EVERY = 10.0  # time between two progress lines, s
_DOMAIN = 91  # DDS domain of live trials


@click.group()
def fuzz() -> None:
    """Test with hostile messages, files, clocks, states and setpoints, floods, killed processes, and long runs.

    Floods, kills and soak start processes in their own DDS domain. The seed reproduces a run. Exit status 1: a test
    failed.
    """
    exit_by_signals(KeyboardInterrupt)  # Hypothesis continues after SystemExit
    # Cache folder of Hypothesis, by default in the current folder.
    folder = Path(tempfile.gettempdir()) / "wbc_controller_hypothesis"
    os.environ.setdefault("HYPOTHESIS_STORAGE_DIRECTORY", str(folder))


def _first(kind: str) -> Callable[[F], F]:
    return click.option("--first", default=0, show_default=True, help=f"Number of the first {kind}.")


_MINUTES = click.FloatRange(0.0, min_open=True)
_seed = click.option("--seed", default=0, show_default=True, help="Seed of all random choices.")
_robots = click.argument("robots", default="go2,g1,talos")
_common = with_options(
    _seed,
    click.option("--out", "folder", type=click.Path(path_type=Path), default=Path("fuzz"), show_default=True,
                 help="Folder of failures and logs."),
)  # fmt: skip
_live = with_options(
    click.option("--domain", default=_DOMAIN, show_default=True, help="DDS domain of the processes."), _common
)
_of_files = with_options(
    _robots,
    click.option("--count", default=20_000, show_default=True, type=click.IntRange(1), help="Number of files."),
    _first("file"),
    _common,
)


@fuzz.command()
@click.argument("robot", default="go2")
@click.option("--count", default=1_000_000, show_default=True, type=click.IntRange(1), help="Total number of messages.")
@click.option("--nodes", default="controller,guard,mock,urdf,estimator", show_default=True, help="Nodes under test.")
@_first("episode of each node")
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
    sys.exit(0 if not outcome.failures and outcome.growth <= run.MAX_GROWTH else 1)


def _files(kind: str, robots: str, count: int, first: int, seed: int, folder: Path) -> None:
    from wbc_controller.validation.fuzz import files as run

    _report(run.fuzz_files(kind, tuple(robots.split(",")), count, seed, folder, first=first), run.summary)


for _kind, _content in (
    ("configurations", "configuration files"),
    ("urdf", "URDFs"),
    ("recordings", "recordings with valid checksums"),
):
    fuzz.command(_kind, help=f"Read hostile {_content}.")(_of_files(partial(_files, _kind)))


@fuzz.command()
@click.option("--count", default=5_000, show_default=True, type=click.IntRange(1), help="Number of classes.")
@_seed
def classes(count: int, seed: int) -> None:
    """Run controllers with a user class with a hostile member: it is refused, or the robot is damped."""
    from wbc_controller.validation.fuzz import hostile_classes as run

    _report(run.fuzz_classes(count, seed), run.summary)


@fuzz.command()
@click.argument("robot", default="go2")
@click.option("--trials", default=100, show_default=True, type=click.IntRange(1), help="Emergency stops per flood.")
@click.option("--kinds", help="Floods, comma-separated; by default all.")
@_live
def floods(robot: str, trials: int, kinds: str | None, domain: int, seed: int, folder: Path) -> None:
    """Flood each kind of input, and check that an emergency stop passes and the loop continues."""
    from wbc_controller.validation.fuzz import floods as run

    chosen = tuple(kinds.split(",")) if kinds else tuple(run.FLOODS)
    _report(run.flood_trials(robot, folder, trials, kinds=chosen, domain=domain, seed=seed), run.summary, every=0.0)


@fuzz.command()
@click.argument("robot", default="go2")
@click.option("--trials", default=50, show_default=True, type=click.IntRange(1), help="Trials per process and signal.")
@_live
def kills(robot: str, trials: int, domain: int, seed: int, folder: Path) -> None:
    """Kill, hang up and stop the controller and the mock robot at random times."""
    from wbc_controller.validation.fuzz import kills as run

    _report(run.kill_trials(robot, folder, trials, domain=domain, seed=seed), run.summary, every=0.0)


@fuzz.command()
@click.argument("robot", default="go2")
@click.option("--minutes", default=30.0, show_default=True, type=_MINUTES, help="Duration.")
@_live
def soak(robot: str, minutes: float, domain: int, seed: int, folder: Path) -> None:
    """Run controller, mock robot and guard for a long time, and monitor memory and faults."""
    from wbc_controller.validation.fuzz import soak as run

    report = _Progress()
    for result in run.soak(robot, folder, 60.0 * minutes, domain):
        report(f"{result.seconds:.0f} s, {result.rate:.0f} commands/s, {len(result.faults)} faults")
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
@_robots
@click.option("--count", default=1000, show_default=True, type=click.IntRange(1), help="Trials per robot.")
@_first("trial")
@_seed
def clocks(robots: str, count: int, first: int, seed: int) -> None:
    """Change clocks, stamps and delivery, pause the controller, and check that no robot falls without a fault."""
    from wbc_controller.validation.fuzz import clocks as run

    numbers = range(first, first + count)
    _report((run.run_trial(robot, seed, n) for robot in robots.split(",") for n in numbers), run.summary)


@fuzz.command()
@_robots
@click.option(
    "--minutes", default=10.0, show_default=True, type=_MINUTES, help="Simulated time under control per robot."
)
@_first("trial")
@_seed
def setpoints(robots: str, minutes: float, first: int, seed: int) -> None:
    """Send infeasible setpoints, and check that joints keep their limits under any relaxation."""
    from wbc_controller.validation.fuzz import setpoints as run

    _report(run.fuzz_setpoints(robots.split(","), minutes, seed, first), run.summary)


@fuzz.command()
@_robots
@click.option("--count", default=10_000, show_default=True, type=click.IntRange(1), help="Problems per robot.")
@_first("problem")
@click.option("--seed", default=0, show_default=True, help="Offset of the problem numbers.")
def problems(robots: str, count: int, first: int, seed: int) -> None:
    """Solve random quadratic programs, and check by linear programs that nothing is relaxed unnecessarily."""
    from wbc_controller.validation.fuzz import problems as run

    _report(run.fuzz_problems(robots.split(","), range(first, first + count), seed), run.summary)


def _report(trials: Iterable[Any], summary: Callable[[Sequence[Any]], Iterable[str]], every: float = _EVERY) -> None:
    progress, done, failed = _Progress(every), list[Any](), 0
    for trial in trials:
        done.append(trial)
        failed += trial.failed
        progress(f"{len(done)} trials, {failed} failed; {trial}")
    for line in summary(done):
        click.echo(line)
    sys.exit(1 if failed else 0)


class _Progress:
    def __init__(self, every: float = _EVERY) -> None:
        self._every, self._due = every, time.monotonic() + every

    def __call__(self, line: str) -> None:
        if time.monotonic() >= self._due:
            self._due = time.monotonic() + self._every
            click.echo(line, err=True)
