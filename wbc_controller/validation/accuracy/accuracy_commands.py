"""The commands of `wbc accuracy`, and the tables that they print."""

import math
import sys
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar, get_args

import click
import numpy as np

from wbc_controller.errors import ConfigurationError, valid_choices
from wbc_controller.nodes.signals import exit_by_signals
from wbc_controller.settings.service import SensorQuality

T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., Any])

#: Acceptance of standing on `good`: roll and pitch in °, height in m, velocity in m/s, drift in m per minute.
TILT, HEIGHT, VELOCITY, DRIFT = 0.2, 0.003, 0.02, 0.01


@click.group()
def accuracy() -> None:
    """Measure a robot without odometry against the truth of the simulation."""
    exit_by_signals()


def _common(function: F) -> F:
    """Options of every command."""
    options = [
        click.argument("robots", nargs=-1, metavar="[ROBOT]..."),
        click.option("--sensors", type=click.Choice(get_args(SensorQuality)), default="good", show_default=True,
                     help="Quality of the mock robot's sensors."),
        click.option("--jobs", default=-1, show_default=True, help="Robots at once; -1 for one per processor."),
    ]  # fmt: skip
    for option in reversed(options):
        function = option(function)
    return function


def _each(function: Callable[..., T], calls: Iterable[Sequence[Any]], jobs: int) -> list[T]:
    """Call a function with each of the arguments, in parallel."""
    import joblib

    found: list[T] = joblib.Parallel(n_jobs=jobs)(joblib.delayed(function)(*call) for call in calls)
    return found


@accuracy.command()
@_common
@click.option("--seeds", default=25, show_default=True, type=click.IntRange(1), help="Robots of each kind.")
@click.option("--seconds", default=60.0, show_default=True, type=click.FloatRange(0.5), help="How long each stands.")
def standing(robots: tuple[str, ...], sensors: str, jobs: int, seeds: int, seconds: float) -> None:
    """Let robots stand without odometry, and compare estimate and truth: g1, talos and go2 by default.

    The filter knows the figures of its sensors, and that the ground is rigid. Prints the RMS of roll and pitch and the
    largest of the other figures over the seeds, and whether the errors are as large as the covariance says. The status
    is 1 where a robot fell, or on `good` is not within the targets.
    """
    from wbc_controller.validation.accuracy.standing import consistency, stand

    click.echo(
        f"{seeds} seeds on {sensors}, {seconds:g} s; of roll and pitch the RMS over the seeds (and the largest), of "
        "the others the largest. NEES: share of time within the 95 % bounds, and its mean (1 as it should be), of "
        "tilt and velocity; of heading and position, which drift\n"
    )
    click.echo("| | roll, pitch RMS | height RMS | velocity RMS | drift per minute | NEES | NEES, drifting | fell |")
    click.echo("|---|---|---|---|---|---|---|---|")
    good = True
    for robot in robots or ("g1", "talos", "go2"):
        found = _each(stand, [(robot, sensors, seed, seconds) for seed in range(seeds)], jobs)
        tilt = float(np.sqrt(np.mean([each.tilt**2 for each in found])))
        steepest, height, velocity, drift = (
            float(np.max([getattr(each, name) for each in found])) for name in ("tilt", "height", "velocity", "drift")
        )
        seen, drifting = consistency([each.seen for each in found], 5), consistency([e.drifting for e in found], 4)
        fell = sum(bool(each.ended) for each in found)
        within = np.degrees(tilt) < TILT and height < HEIGHT and velocity < VELOCITY and drift < DRIFT
        good = good and not fell and (sensors != "good" or bool(within))
        click.echo(
            f"| {robot} | {np.degrees(tilt):.3f}° ({np.degrees(steepest):.3f}°) | {1e3 * height:.2f} mm | "
            f"{1e3 * velocity:.1f} mm/s | {1e3 * drift:.1f} mm | {100.0 * seen[0]:.0f} %, {seen[1]:.2f} | "
            f"{100.0 * drifting[0]:.0f} %, {drifting[1]:.2f} | {fell} |"
        )
        for each in found:
            if each.ended:
                click.echo(f"{robot}, seed {each.seed}: {each.ended.splitlines()[0]}", err=True)
    sys.exit(0 if good else 1)


@accuracy.command()
@_common
@click.option("--flaw", "names", multiple=True, help="A row of the table by its beginning; all by default.")
@click.option("--disturbance", type=click.Choice(("never", "imu")), default="imu", show_default=True,
              help="estimation.disturbance.")  # fmt: skip
@click.option("--known-friction", is_flag=True, help="The controller knows the joint friction of the flaw.")
def flaws(
    robots: tuple[str, ...], sensors: str, jobs: int, names: tuple[str, ...], disturbance: str, known_friction: bool
) -> None:
    """Let robots with a flaw sway and squat without odometry: g1, talos and go2 by default.

    Prints the largest error of the true centre of mass in mm, in the sway of 30 mm and the squat of 50 mm, and the
    torque above 8 Hz as a share of the limits. The status is 1 where a robot fell.
    """
    from wbc_controller.validation.accuracy.flaws import FLAWS, cost_of

    for name in names:
        if not any(flaw.name.startswith(name) for flaw in FLAWS):
            raise ConfigurationError(f"flaw {name!r} is unknown; {valid_choices(name, [flaw.name for flaw in FLAWS])}")
    chosen = [flaw for flaw in FLAWS if not names or flaw.name.startswith(names)]
    kinds = robots or ("g1", "talos", "go2")
    costs = _each(cost_of, [(k, f.name, sensors, disturbance, known_friction) for f in chosen for k in kinds], jobs)
    click.echo(f"sensors {sensors}, estimation.disturbance {disturbance}; mm in sway, squat; torque above 8 Hz\n")
    click.echo(f"| Flaw | {' | '.join(kinds)} |\n|---|{'---|' * len(kinds)}")
    for i, flaw in enumerate(chosen):
        cells = [
            f"ends: {cost.ended.split(':')[0]}"
            if cost.ended
            else f"{1e3 * cost.sway:.1f}, {1e3 * cost.squat:.1f}; {100.0 * cost.chatter:.1f} %"
            for cost in costs[i * len(kinds) : (i + 1) * len(kinds)]
        ]
        click.echo(f"| {flaw.name} | {' | '.join(cells)} |")
    sys.exit(1 if any(cost.ended for cost in costs) else 0)


@accuracy.command()
@_common
@click.option("--seeds", default=1, show_default=True, type=click.IntRange(1), help="Robots of each kind.")
@click.option("--force-sensors", is_flag=True, help="The controller hears the true force at each contact.")
def mishaps(robots: tuple[str, ...], sensors: str, jobs: int, seeds: int, force_sensors: bool) -> None:
    """Let robots without odometry meet with mishaps while they sway: g1, talos and go2 by default.

    Prints whether they go on or which fault ends it, the largest error of the base's velocity, the longest time above
    0.2 m/s without a fault, the time from 'reset' to an active controller after the fault, with the robot on the hoist,
    and the contacts that the estimate left out. The status is 1 if an estimate was silently wrong (above 0.2 m/s for
    more than 0.3 s without a fault, or until the robot lay on the floor), or 'activate' stayed refused.
    """
    from wbc_controller.validation.accuracy.mishaps import MISHAPS, come_of

    kinds = robots or ("g1", "talos", "go2")
    calls = [(kind, each.name, sensors, s, force_sensors) for kind in kinds for each in MISHAPS for s in range(seeds)]
    found = _each(come_of, calls, jobs)
    click.echo(f"sensors {sensors}{', true forces at the contacts' if force_sensors else ''}\n")
    click.echo(
        "| Robot | Mishap | outcome | velocity error | above 0.2 m/s without a fault | active again | left out |"
    )
    click.echo("|---|---|---|---|---|---|---|")
    for (kind, name, *_), each in zip(calls, found, strict=True):
        came = "**silently wrong**" if each.silently_wrong else "ends" if each.ended else "goes on"
        came = "; ".join([came, *(sentence.partition(" (")[0] for sentence in each.said)])
        recovery = (
            f"{each.recovery:.2f} s"
            if math.isfinite(each.recovery)
            else "–"
            if math.isnan(each.recovery)
            else "**refused**"
        )
        click.echo(
            f"| {kind} | {name} | {came} | {each.error:.3f} m/s | {1e3 * each.unsaid:.0f} ms | {recovery} | "
            f"{', '.join(each.left_out) or '–'} |"
        )
    sys.exit(0 if all(each.good for each in found) else 1)


@accuracy.command()
@_common
@click.option("--seeds", default=25, show_default=True, type=click.IntRange(1), help="Walks of each kind.")
@click.option("--seconds", default=30.0, show_default=True, type=click.FloatRange(6.0), help="Time of each walk.")
@click.option("--scale", default=1.0, show_default=True, type=click.FloatRange(0.0), help="Factor of the velocities.")
@click.option("--command", "names", multiple=True, help="One of the commands of the table; all by default.")
def walking(
    robots: tuple[str, ...], sensors: str, jobs: int, seeds: int, seconds: float, scale: float, names: tuple[str, ...]
) -> None:
    """Let robots walk without odometry by `cmd_vel`, stop and stand: g1 and talos by default.

    Prints the commanded velocity, the mean velocity, the largest drift of the estimate as a share of the way, the
    number of cycles with relaxed limits, and the falls. The status is 1 if a robot fell.
    """
    from wbc_controller.validation.accuracy.walks import COMMANDS, RANDOM, walk

    kinds = robots or tuple(COMMANDS)
    for kind in kinds:
        if kind not in COMMANDS:
            raise ConfigurationError(f"robot {kind!r} has no commands to walk; {valid_choices(kind, COMMANDS)}")
    rows = [(kind, name) for kind in kinds for name in (*COMMANDS[kind], RANDOM) if not names or name in names]
    if not rows:
        known = sorted({name for kind in kinds for name in (*COMMANDS[kind], RANDOM)})
        raise ConfigurationError(f"command {names[0]!r} is unknown; {valid_choices(names[0], known)}")
    click.echo(f"{seeds} seeds on {sensors}, {seconds:g} s, velocities times {scale:g}\n")
    click.echo("| Robot | Command | m/s, m/s, rad/s | reached | drift, share of the way | relaxed cycles | fell |")
    click.echo("|---|---|---|---|---|---|---|")
    fallen = 0
    for kind, name in rows:
        found = _each(walk, [(kind, name, sensors, seed, seconds, scale) for seed in range(seeds)], jobs)
        fell = [each for each in found if each.ended]
        fallen += len(fell)
        wanted = "" if name == RANDOM else ", ".join(f"{scale * each:g}" for each in COMMANDS[kind][name])
        whole = [each for each in found if not each.ended]
        reached = "" if name == RANDOM or not whole else ", ".join(
            f"{each:.2f}" for each in np.mean([walk.speed for walk in whole], axis=0)
        )  # fmt: skip
        drift = max((each.drift / max(each.distance, 1.0) for each in whole), default=math.nan)
        relaxed = sum(each.relaxed for each in found)
        click.echo(f"| {kind} | {name} | {wanted} | {reached} | {100.0 * drift:.1f} % | {relaxed} | {len(fell)} |")
        for each in fell:
            click.echo(f"{kind}, {name}, seed {each.seed}: {each.ended.splitlines()[0]}", err=True)
    sys.exit(1 if fallen else 0)
