"""Commands of `wbc accuracy` for walks."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np

from wbc_controller.errors import ConfigurationError, require_known
from wbc_controller.extras import require_libraries
from wbc_controller.settings.service import SensorQuality
from wbc_controller.validation.accuracy.parallel import common_options, print_header, print_row, run_parallel

if TYPE_CHECKING:
    from wbc_controller.validation.accuracy.walks import Walk

#: Headings of the cells of `figures_of`.
FIGURES = ("torque", "rate at touchdown", "chatter", "slip", "outside the cone")
RATIO, DIRECTIONS = 1.5, 0.75  # required impulse as a multiple of a standing robot's, and in how many directions of 8
#: Largest share of falls: of 10 walks on a ground, and of the walks with changes of velocity.
FALLS, FALLS_BY_CHANGES = 0.1, 0.05


def figures_of(walks: Sequence[Walk]) -> tuple[str, ...]:
    """Return the largest figures of walks as cells."""
    torque, rate, chatter, slip, outside = (
        max(getattr(each.figures, key) for each in walks) for key in ("torque", "rate", "chatter", "slip", "outside")
    )
    return f"{torque:.2f}", f"{rate:.2f}", f"{100.0 * chatter:.1f} %", f"{1e3 * slip:.1f} mm", f"{outside:.1g} N"


def walking_robots(robots: Sequence[str]) -> Sequence[str]:
    """Return the robots, by default all that walk; an unknown one raises `ConfigurationError`."""
    from wbc_controller.validation.accuracy.walks import COMMANDS

    require_known(robots, COMMANDS, "unknown walking robot")
    return robots or tuple(COMMANDS)


@click.command()
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
    from wbc_controller.validation.accuracy.walks import COMMANDS, RANDOM, walk

    kinds = walking_robots(robots)
    require_known(names, sorted({name for kind in kinds for name in (*COMMANDS[kind], RANDOM)}), "unknown command")
    rows = [(kind, name) for kind in kinds for name in (*COMMANDS[kind], RANDOM) if not names or name in names]
    click.echo(f"{seeds} seeds on {sensors}, {seconds:g} s, velocities times {scale:g}\n")
    motion = ("m/s, m/s, rad/s", "reached", "drift of the path", "relaxed")
    print_header("Robot", "Command", *motion, *FIGURES, "fell", "lead")
    fallen = 0
    for kind, name in rows:
        given = COMMANDS[kind].get(name)  # None for random velocities
        found = run_parallel(walk, [(kind, given, sensors, seed, seconds, scale) for seed in range(seeds)], jobs)
        fell = [each for each in found if each.ended]
        fallen += len(fell)
        commanded = ", ".join(f"{scale * each:g}" for each in given or ())
        whole = [each for each in found if not each.ended]
        reached = "" if given is None or not whole else ", ".join(
            f"{each:.2f}" for each in np.mean([walk.speed for walk in whole], axis=0)
        )  # fmt: skip
        drift = max((each.drift / max(each.distance, 1.0) for each in whole), default=math.nan)
        relaxed = sum(each.relaxed for each in found)
        leads = [each.lead for each in fell if not math.isnan(each.lead)]
        lead = f"{min(leads):.2f} s" if leads else ""
        print_row(
            kind, name, commanded, reached, f"{100.0 * drift:.1f} %", relaxed, *figures_of(found), len(fell), lead
        )
        for seed, each in enumerate(found):
            if each.ended:
                click.echo(f"{kind}, {name}, seed {seed}: {each.ended}", err=True)
    sys.exit(1 if fallen else 0)


@click.command("walking-grounds")
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
    from wbc_controller.validation.accuracy.walks import GROUNDS, walk_on

    require_known(names, GROUNDS, "unknown ground")
    click.echo(f"{seeds} seeds on {sensors}, {seconds:g} s\n")
    print_header("Robot", "Ground", "distance", "relaxed", *FIGURES, "fell")
    good = True
    for robot in walking_robots(robots):
        for ground in names or GROUNDS:
            calls = [(robot, ground, sensors, seed, seconds) for seed in range(seeds)]
            found = run_parallel(walk_on, calls, jobs)
            fell = sum(bool(each.ended) for each in found)
            good = good and fell <= max(FALLS * seeds, 0.0 if seeds < 10 else 1.0)
            distance = float(np.mean([each.distance for each in found]))
            relaxed = sum(each.relaxed for each in found)
            print_row(robot, ground, f"{distance:.1f} m", relaxed, *figures_of(found), f"{fell} of {seeds}")
            for seed, each in enumerate(found):
                if each.ended:
                    click.echo(f"{robot}, {ground}, seed {seed}: {each.ended}", err=True)
    sys.exit(0 if good else 1)


@click.command("walking-starts")
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


@click.command("walking-pushes")
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
    if plot is not None and len(kinds) > 1:
        raise ConfigurationError(f"--plot shows one robot, got {', '.join(kinds)}")
    if plot is not None:
        require_libraries("plotly")
    angles = [math.tau * index / directions for index in range(directions)]
    good = True
    for robot in kinds:
        pushes = [Push(angle, phase) for angle in angles for phase in (None, *(i / phases for i in range(phases)))]
        found = run_parallel(largest_impulse, [(robot, push, sensors, 0) for push in pushes], jobs)
        impulses = np.array(found).reshape(directions, 1 + phases)
        standing, walking = impulses[:, 0], impulses[:, 1:]
        click.echo(f"{robot} on {sensors}, pushes of 0.1 s at the base, {phases} phases\n")
        print_header(
            "Direction", "standing", "in place, smallest", "in place, mean", "smallest / standing", "mean / standing"
        )
        multiples = walking / np.maximum(standing, 1.0e-9)[:, None]
        ratios = multiples.min(axis=1)
        for angle, still, steps, ratio, mean in zip(
            angles, standing, walking, ratios, multiples.mean(axis=1), strict=True
        ):
            cells = [f"{each:.1f} N·s" for each in (still, steps.min(), steps.mean())]
            print_row(f"{math.degrees(angle):.0f}°", *cells, f"{ratio:.2f}", f"{mean:.2f}")
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

    lines = {
        "standing": standing,
        "in place, worst phase": walking.min(axis=1),
        "in place, best phase": walking.max(axis=1),
    }
    figure = polar(lines, [math.degrees(angle) for angle in angles], unit="N·s")
    caption = (
        "Largest survived impulse of a push of 0.1 s at the base, by its direction; 0° is forward, 90° to the left."
    )
    plot = Plot("pushes", "Survived pushes", caption, figure)
    write_page(PageReport(title=robot, kind="wbc accuracy walking-pushes", verdict=caption, plots=[plot]), path)


WALKING = (walking, walking_grounds, walking_starts, walking_pushes)  # commands of this module
