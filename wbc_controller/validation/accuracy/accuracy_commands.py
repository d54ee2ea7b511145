"""Commands of `wbc accuracy`."""

import math
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args

import click
import numpy as np

from wbc_controller.apps.terminal.command_options import jobs_option, with_options
from wbc_controller.errors import ConfigurationError, require_known, valid_choices
from wbc_controller.extras import require_libraries
from wbc_controller.nodes.processes import end_with_parent
from wbc_controller.nodes.signals import exit_by_signals
from wbc_controller.settings.service import SensorQuality

T = TypeVar("T")

#: Acceptance of standing on `good`: roll and pitch in °, height in m, velocity in m/s, drift in m per minute.
TILT, HEIGHT, VELOCITY, DRIFT = 0.2, 0.003, 0.02, 0.01
RATIO, DIRECTIONS = 1.5, 0.75  # required impulse as a multiple of a standing robot's, and in how many directions of 8
#: Largest share of falls: of 10 walks on a ground, and of the walks with changes of velocity.
FALLS, FALLS_BY_CHANGES = 0.1, 0.05

common_options = with_options(
    click.argument("robots", nargs=-1, metavar="[ROBOT]..."),
    click.option("--sensors", type=click.Choice(get_args(SensorQuality)), default="good", show_default=True,
                 help="Quality of the mock robot's sensors."),
    jobs_option("robots"),
)  # fmt: skip


@click.group()
def accuracy() -> None:
    """Measure a robot without odometry against the simulation."""
    exit_by_signals()


@accuracy.command()
@common_options
@click.option("--seeds", default=25, show_default=True, type=click.IntRange(1), help="Robots of each type.")
@click.option("--seconds", default=60.0, show_default=True, type=click.FloatRange(0.5), help="Duration of standing, s.")
def standing(robots: tuple[str, ...], sensors: str, jobs: int, seeds: int, seconds: float) -> None:
    """Compare estimate and truth of standing robots without odometry; by default g1, talos and go2.

    Prints the RMS of roll and pitch, the largest other errors over the seeds, and the consistency of errors and
    covariance. Exit status 1: a robot fell, or errors on `good` exceed the targets.
    """
    from wbc_controller.validation.accuracy.standing import consistency, stand

    click.echo(
        f"{seeds} seeds on {sensors}, {seconds:g} s. Roll and pitch: RMS over the seeds (largest). Other errors: "
        "largest. NEES: share of time within the 95 % bounds, and mean (ideal: 1); first for tilt and velocity, then "
        "for the drifting heading and position\n"
    )
    columns = ("height RMS", "velocity RMS", "drift per minute", "NEES", "NEES, drifting", "fell")
    print_header("", "roll, pitch RMS", *columns)
    good = True
    for robot in robots or ("g1", "talos", "go2"):
        found = run_parallel(stand, [(robot, sensors, seed, seconds) for seed in range(seeds)], jobs)
        errors = np.array([(each.tilt, each.height, each.velocity, each.drift) for each in found])
        tilt = np.degrees(np.sqrt(np.mean(errors[:, 0] ** 2)))
        steepest, height, velocity, drift = errors.max(axis=0)
        observable = consistency([each.observable_nees for each in found], 5)
        drifting = consistency([each.drifting_nees for each in found], 4)
        fell = sum(bool(each.ended) for each in found)
        within = tilt < TILT and height < HEIGHT and velocity < VELOCITY and drift < DRIFT
        good = good and not fell and (sensors != "good" or bool(within))
        nees = [f"{100.0 * share:.0f} %, {mean:.2f}" for share, mean in (observable, drifting)]
        tilts = f"{tilt:.3f}° ({np.degrees(steepest):.3f}°)"
        motion = f"{1e3 * height:.2f} mm", f"{1e3 * velocity:.1f} mm/s", f"{1e3 * drift:.1f} mm"
        print_row(robot, tilts, *motion, *nees, fell)
        for seed, each in enumerate(found):
            if each.ended:
                click.echo(f"{robot}, seed {seed}: {each.ended.splitlines()[0]}", err=True)
    sys.exit(0 if good else 1)


@accuracy.command()
@common_options
@click.option("--flaw", "names", multiple=True, help="Beginning of a row's name; by default all rows.")
@click.option("--disturbance", type=click.Choice(("never", "imu")), default="imu", show_default=True,
              help="estimation.disturbance.")  # fmt: skip
@click.option("--known-friction", is_flag=True, help="Give the joint friction of the flaw to the controller.")
def flaws(
    robots: tuple[str, ...], sensors: str, jobs: int, names: tuple[str, ...], disturbance: str, known_friction: bool
) -> None:
    """Measure swaying and squatting robots with a flaw, without odometry; by default g1, talos and go2.

    Prints the largest error of the true centre of mass, mm, and the torque above 8 Hz as a share of the limits. Exit
    status 1: a robot fell.
    """
    from wbc_controller.validation.accuracy.flaws import FLAWS, measure_flaw

    for name in names:
        if not any(flaw.name.startswith(name) for flaw in FLAWS):
            raise ConfigurationError(f"unknown flaw {name!r}; {valid_choices(name, [flaw.name for flaw in FLAWS])}")
    chosen = [flaw for flaw in FLAWS if not names or flaw.name.startswith(names)]
    kinds = robots or ("g1", "talos", "go2")
    calls = [(kind, flaw.name, sensors, disturbance, known_friction) for flaw in chosen for kind in kinds]
    results = run_parallel(measure_flaw, calls, jobs)
    click.echo(f"sensors {sensors}, estimation.disturbance {disturbance}; mm in sway, squat; torque above 8 Hz\n")
    print_header("Flaw", *kinds)
    for i, flaw in enumerate(chosen):
        cells = [
            f"ends: {result.ended.split(':')[0]}"
            if result.ended
            else f"{1e3 * result.sway:.1f}, {1e3 * result.squat:.1f}; {100.0 * result.chatter:.1f} %"
            for result in results[i * len(kinds) : (i + 1) * len(kinds)]
        ]
        print_row(flaw.name, *cells)
    sys.exit(1 if any(result.ended for result in results) else 0)


@accuracy.command()
@common_options
@click.option("--seeds", default=1, show_default=True, type=click.IntRange(1), help="Robots of each type.")
@click.option("--force-sensors", is_flag=True, help="Give the true contact forces to the controller.")
def mishaps(robots: tuple[str, ...], sensors: str, jobs: int, seeds: int, force_sensors: bool) -> None:
    """Apply contact and sensor faults to swaying robots without odometry; by default g1, talos and go2.

    Prints the faults, the largest error of the base velocity, the longest time above 0.2 m/s without a fault, the
    time from 'reset' to an active controller, and the excluded contacts. Exit status 1: an estimate was silently wrong
    (0.3 s above 0.2 m/s without a fault, or a fall), or 'activate' was refused permanently.
    """
    from wbc_controller.validation.accuracy.mishaps import MISHAPS, run_mishap

    kinds = robots or ("g1", "talos", "go2")
    calls = [(kind, each.name, sensors, s, force_sensors) for kind in kinds for each in MISHAPS for s in range(seeds)]
    found = run_parallel(run_mishap, calls, jobs)
    click.echo(f"sensors {sensors}{', with true contact forces' if force_sensors else ''}\n")
    columns = ("velocity error", "above 0.2 m/s without a fault", "active again", "left out")
    print_header("Robot", "Mishap", "outcome", *columns)
    for (kind, name, *_), each in zip(calls, found, strict=True):
        outcome = "**silently wrong**" if each.silently_wrong else "ends" if each.ended else "continues"
        outcome = "; ".join([outcome, *(sentence.partition(" (")[0] for sentence in each.fault_texts)])
        recovery = "–" if math.isnan(each.recovery) else "**refused**"
        if math.isfinite(each.recovery):
            recovery = f"{each.recovery:.2f} s"
        undetected, left_out = f"{1e3 * each.undetected:.0f} ms", ", ".join(each.left_out) or "–"
        print_row(kind, name, outcome, f"{each.error:.3f} m/s", undetected, recovery, left_out)
    sys.exit(1 if any(each.silently_wrong or math.isinf(each.recovery) for each in found) else 0)


def walking_robots(robots: Sequence[str]) -> Sequence[str]:
    """Return the robots, by default the supplied ones; one that does not walk raises `ConfigurationError`."""
    from wbc_controller.validation.accuracy.walks import COMMANDS, commands_of

    return [robot for robot in robots or COMMANDS if commands_of(robot)]


@accuracy.command()
@common_options
@click.option("--seeds", default=25, show_default=True, type=click.IntRange(1), help="Walks per command.")
@click.option("--seconds", default=30.0, show_default=True, type=click.FloatRange(6.0), help="Duration of a walk, s.")
@click.option("--scale", default=1.0, show_default=True, type=click.FloatRange(0.0), help="Factor of the velocities.")
@click.option("--command", "names", multiple=True, help="Command of the table; by default all.")
def walking(
    robots: tuple[str, ...], sensors: str, jobs: int, seeds: int, seconds: float, scale: float, names: tuple[str, ...]
) -> None:
    """Walk without odometry by `cmd_vel`, stop and stand; by default g1, talos and go2.

    Prints commanded and mean velocity, drift as a share of the path, cycles with relaxed limits, `WalkFigures`, falls,
    and the shortest time from a fault to the ground contact of another link. Exit status 1: a robot fell.
    """
    from wbc_controller.validation.accuracy.walks import FIGURES, RANDOM, commands_of, figures_of, walk

    kinds = walking_robots(robots)
    rows = [(kind, name) for kind in kinds for name in (*commands_of(kind), RANDOM)]
    require_known(names, sorted({name for _, name in rows}), "unknown command")
    rows = [(kind, name) for kind, name in rows if not names or name in names]
    click.echo(f"{seeds} seeds on {sensors}, {seconds:g} s, velocities times {scale:g}\n")
    columns = ("m/s, m/s, rad/s", "reached", "drift of the path", "relaxed")
    print_header("Robot", "Command", *columns, *FIGURES, "fell", "lead")
    fallen = 0
    for kind, name in rows:
        given = commands_of(kind).get(name)  # None for random velocities
        found = run_parallel(walk, [(kind, given, sensors, seed, seconds, scale) for seed in range(seeds)], jobs)
        fell = [each for each in found if each.ended]
        fallen += len(fell)
        commanded = ", ".join(f"{scale * each:.3g}" for each in given or ())
        whole = [each for each in found if not each.ended]
        speeds = [walk.speed for walk in whole if given is not None]
        reached = ", ".join(f"{each:.2f}" for each in np.mean(speeds, axis=0)) if speeds else ""
        drift = max((each.drift / max(each.distance, 1.0) for each in whole), default=math.nan)
        relaxed = sum(each.relaxed for each in found)
        leads = [each.lead for each in fell if not math.isnan(each.lead)]
        lead = f"{min(leads):.2f} s" if leads else ""
        motion = commanded, reached, f"{100.0 * drift:.1f} %", relaxed
        print_row(kind, name, *motion, *figures_of(found), len(fell), lead)
        for seed, each in enumerate(found):
            if each.ended:
                click.echo(f"{kind}, {name}, seed {seed}: {each.ended}", err=True)
    sys.exit(1 if fallen else 0)


@accuracy.command("walking-grounds")
@common_options
@click.option("--seeds", default=10, show_default=True, type=click.IntRange(1), help="Walks on each ground.")
@click.option("--seconds", default=20.0, show_default=True, type=click.FloatRange(1.0), help="Duration of a walk, s.")
@click.option("--ground", "names", multiple=True, help="Ground of the table; by default all.")
def walking_grounds(
    robots: tuple[str, ...], sensors: SensorQuality, jobs: int, seeds: int, seconds: float, names: tuple[str, ...]
) -> None:
    """Walk onto unknown ground, stop and stand; by default g1, talos and go2.

    Grounds: cells with random heights of ±2 cm, slopes of 5° up, down and across, friction 0.4, soft ground. Exit
    status 1: more than one of ten walks ended early.
    """
    from wbc_controller.validation.accuracy.walks import FIGURES, GROUNDS, figures_of, walk_on

    require_known(names, GROUNDS, "unknown ground")
    click.echo(f"{seeds} seeds on {sensors}, {seconds:g} s\n")
    print_header("Robot", "Ground", "distance", "relaxed", *FIGURES, "fell")
    good = True
    for robot in walking_robots(robots):
        for ground in names or GROUNDS:
            found = run_parallel(walk_on, [(robot, ground, sensors, seed, seconds) for seed in range(seeds)], jobs)
            fell = sum(bool(each.ended) for each in found)
            good = good and fell <= max(FALLS * seeds, 0.0 if seeds < 10 else 1.0)
            distance = float(np.mean([each.distance for each in found]))
            relaxed = sum(each.relaxed for each in found)
            print_row(robot, ground, f"{distance:.1f} m", relaxed, *figures_of(found), f"{fell} of {seeds}")
            for seed, each in enumerate(found):
                if each.ended:
                    click.echo(f"{robot}, {ground}, seed {seed}: {each.ended}", err=True)
    sys.exit(0 if good else 1)


@accuracy.command("walking-starts")
@common_options
@click.option("--seeds", default=10, show_default=True, type=click.IntRange(1), help="Robots of each type.")
@click.option("--count", default=10, show_default=True, type=click.IntRange(1), help="Starts and stops of each robot.")
def walking_starts(robots: tuple[str, ...], sensors: SensorQuality, jobs: int, seeds: int, count: int) -> None:
    """Start and stop at random times and velocities; by default g1, talos and go2.

    Prints the number of stops by their steps. Exit status 1: a robot fell, or took more than three steps to stand.
    """
    from wbc_controller.validation.accuracy.walks import MOST_STEPS, start_and_stop

    click.echo(f"{seeds} seeds with {count} starts and stops each, on {sensors}\n")
    print_header("Robot", "Stops", "stops by number of steps", "fell")
    good = True
    for robot in walking_robots(robots):
        found = run_parallel(start_and_stop, [(robot, sensors, seed, count) for seed in range(seeds)], jobs)
        steps = [number for each in found for number in each.steps]
        fell = sum(bool(each.ended) for each in found)
        good = good and not fell and max(steps, default=0) <= MOST_STEPS
        by_number = ", ".join(f"{number}: {steps.count(number)}" for number in sorted(set(steps)))
        print_row(robot, len(steps), by_number, fell)
        for seed, each in enumerate(found):
            if each.ended:
                click.echo(f"{robot}, seed {seed}, after {len(each.steps)} stops: {each.ended}", err=True)
    sys.exit(0 if good else 1)


@accuracy.command("walking-pushes")
@common_options
@click.option("--directions", default=8, show_default=True, type=click.IntRange(1), help="Directions of the pushes.")
@click.option("--phases", default=8, show_default=True, type=click.IntRange(1), help="Phases of the stride.")
@click.option("--changes", default=25, show_default=True, type=click.IntRange(0),
              help="Robots with random changes of their velocity.")  # fmt: skip
@click.option("--seconds", default=20.0, show_default=True, type=click.FloatRange(1.0),
              help="Duration of the changes, s.")  # fmt: skip
@click.option("--plot", type=click.Path(dir_okay=False, path_type=Path), help="HTML page with a polar plot.")
def walking_pushes(
    robots: tuple[str, ...], sensors: SensorQuality, jobs: int, directions: int, phases: int, changes: int,
    seconds: float, plot: Path | None,
) -> None:  # fmt: skip
    """Push robots that step in place, compared with standing; by default g1, talos and go2.

    Pushes of 0.1 s at the base: prints the largest survived impulse, the smallest and the mean over the phases of the
    stride. Then the velocity changes by up to ±0.5 m/s every 1 to 3 s. Exit status 1: the smallest impulse is below 1.5
    times standing in more than a quarter of the directions, or below standing in one, or more than 5 % fell.
    """
    from wbc_controller.validation.accuracy.walk_pushes import Push, change_velocity, largest_impulse

    kinds = walking_robots(robots)
    if plot is not None:
        if len(kinds) > 1:
            raise ConfigurationError(f"--plot shows one robot, got {', '.join(kinds)}")
        require_libraries("plotly")
    angles = [math.tau * index / directions for index in range(directions)]
    good = True
    for robot in kinds:
        pushes = [Push(angle, phase) for angle in angles for phase in (None, *(i / phases for i in range(phases)))]
        found = run_parallel(largest_impulse, [(robot, push, sensors, 0) for push in pushes], jobs)
        impulses = np.array(found).reshape(directions, 1 + phases)
        standing, walking = impulses[:, 0], impulses[:, 1:]
        click.echo(f"{robot} on {sensors}, pushes of 0.1 s at the base, {phases} phases\n")
        steps = ("in place, smallest", "in place, mean")
        print_header("Direction", "standing", *steps, "smallest / standing", "mean / standing")
        multiples = walking / np.maximum(standing, 1.0e-9)[:, None]
        columns = standing, walking.min(axis=1), walking.mean(axis=1), multiples.min(axis=1), multiples.mean(axis=1)
        for angle, *figures, ratio, mean in zip(angles, *columns, strict=True):
            cells = [f"{each:.1f} N·s" for each in figures]
            print_row(f"{math.degrees(angle):.0f}°", *cells, f"{ratio:.2f}", f"{mean:.2f}")
        ratios = multiples.min(axis=1)
        good = good and bool(np.mean(ratios >= RATIO) >= DIRECTIONS and np.all(ratios >= 1.0))
        if plot is not None:
            _write_plot(plot, robot, angles, standing, walking)
        if changes:
            ends = run_parallel(change_velocity, [(robot, sensors, seed, seconds) for seed in range(changes)], jobs)
            fell = sum(map(bool, ends))
            good = good and fell <= FALLS_BY_CHANGES * changes
            click.echo(f"\nvelocity changed by up to ±0.5 m/s, {seconds:g} s: {fell} of {changes} fell\n")
            for seed, text in enumerate(ends):
                if text:
                    click.echo(f"{robot}, changes, seed {seed}: {text}", err=True)
    sys.exit(0 if good else 1)


def _write_plot(path: Path, robot: str, angles: Sequence[float], standing: np.ndarray, walking: np.ndarray) -> None:
    from wbc_controller.controller.visualization.page_report import PageReport, Plot, write_page
    from wbc_controller.controller.visualization.plots import polar

    worst, best = walking.min(axis=1), walking.max(axis=1)
    lines = {"standing": standing, "in place, worst phase": worst, "in place, best phase": best}
    figure = polar(lines, np.degrees(angles).tolist(), unit="N·s")
    caption = (
        "Largest survived impulse of a push of 0.1 s at the base, by its direction; 0° is forward, 90° to the left."
    )
    plot = Plot("pushes", "Survived pushes", caption, figure)
    write_page(PageReport(title=robot, kind="wbc accuracy walking-pushes", verdict=caption, plots=[plot]), path)


def run_parallel(function: Callable[..., T], calls: Iterable[Sequence[Any]], jobs: int) -> list[T]:
    """Return the results of a function for several arguments."""
    import joblib

    parallel = joblib.Parallel(jobs, "loky", initializer=end_with_parent)
    found: list[T] = parallel(joblib.delayed(function)(*call) for call in calls)
    return found


def print_header(*columns: str) -> None:
    """Print the head of a Markdown table."""
    print_row(*columns)
    click.echo("|" + "---|" * len(columns))


def print_row(*cells: object) -> None:
    """Print a row of a Markdown table."""
    click.echo("|" + "|".join(f" {cell} " if str(cell) else " " for cell in cells) + "|")
