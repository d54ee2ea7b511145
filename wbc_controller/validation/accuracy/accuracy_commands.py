"""Commands of `wbc accuracy`."""

import math
import sys

import click
import numpy as np

from wbc_controller.errors import ConfigurationError, valid_choices
from wbc_controller.nodes.signals import exit_by_signals
from wbc_controller.validation.accuracy.parallel import common_options, print_header, print_row, run_parallel
from wbc_controller.validation.accuracy.walking_commands import WALKING

#: Acceptance of standing on `good`: roll and pitch in °, height in m, velocity in m/s, drift in m per minute.
TILT, HEIGHT, VELOCITY, DRIFT = 0.2, 0.003, 0.02, 0.01


@click.group()
def accuracy() -> None:
    """Measure a robot without odometry against the simulation."""
    exit_by_signals()


for _command in WALKING:
    accuracy.add_command(_command)


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
        tilt = float(np.sqrt(np.mean([each.tilt**2 for each in found])))
        steepest, height, velocity, drift = (
            float(np.max([getattr(each, name) for each in found])) for name in ("tilt", "height", "velocity", "drift")
        )
        observable = consistency([each.observable_nees for each in found], 5)
        drifting = consistency([each.drifting_nees for each in found], 4)
        fell = sum(bool(each.ended) for each in found)
        within = np.degrees(tilt) < TILT and height < HEIGHT and velocity < VELOCITY and drift < DRIFT
        good = good and not fell and (sensors != "good" or bool(within))
        nees = [f"{100.0 * share:.0f} %, {mean:.2f}" for share, mean in (observable, drifting)]
        tilts = f"{np.degrees(tilt):.3f}° ({np.degrees(steepest):.3f}°)"
        print_row(
            robot, tilts, f"{1e3 * height:.2f} mm", f"{1e3 * velocity:.1f} mm/s", f"{1e3 * drift:.1f} mm", *nees, fell
        )
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
    results = run_parallel(
        measure_flaw, [(k, f.name, sensors, disturbance, known_friction) for f in chosen for k in kinds], jobs
    )
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
