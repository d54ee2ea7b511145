"""Measure the cycles of a robot that stands and walks in turn, as shares of a cycle while standing.

A cycle includes the base estimate, messages, audit and status, on the memory transport. Medians of the processor time
of the thread, without that of its clock. Run: python benchmarks/walking.py [ROBOT ...] [--walks N]
"""

import argparse
import logging
import time
from functools import partial
from typing import Any

import numpy as np
from timing import timed

from wbc_controller.validation.accuracy.estimation_trial import EstimationTrial
from wbc_controller.walking.footsteps import Velocity
from wbc_controller.walking.gait import Phase

#: Kinds of cycles; a switch changes the active contacts.
STAND, WALK, SWITCH, FIRST, UPDATE = "standing", "walking", "switch", "first use of contacts", "walker alone"
#: Durations of standing and walking, and of the end of the walk, s; velocity forward as a share of the largest.
_STANDING, _WALKING, _STOPPING, _SPEED = 1.0, 4.0, 3.5, 0.6


def _clock_seconds() -> float:
    times: list[float] = []
    empty = timed(lambda: None, lambda seconds, _: times.append(seconds), time.thread_time)
    for _ in range(1000):
        empty()
    return float(np.median(times))


def measure(robot: str, walks: int) -> dict[str, list[float]]:
    """Return the times of all cycles, s, by kind; cycles while weights change count as neither standing nor walking."""
    trial = EstimationTrial(robot, {"estimation.base_state": "imu", "mock.sensors": "good"})
    trial.stand()
    walker = trial.controller.walker
    if walker is None:
        raise SystemExit(f"{robot} does not walk")
    times: dict[str, list[float]] = {kind: [] for kind in (STAND, WALK, SWITCH, FIRST, UPDATE)}
    seen, before = {tuple(sorted(trial.controller.holding))}, tuple(sorted(trial.controller.holding))

    def add_cycle(seconds: float, report: Any) -> None:
        nonlocal before
        contacts = tuple(sorted(report.solution.forces))
        if contacts != before:
            times[SWITCH if contacts in seen else FIRST].append(seconds)
            seen.add(contacts)
        elif walker.phase is Phase.STAND:
            times[STAND].append(seconds)
        elif walker.phase is not Phase.SHIFT:
            times[WALK].append(seconds)
        before = contacts

    update = partial(type(walker).update, walker)
    walker.update = timed(update, lambda seconds, _: times[UPDATE].append(seconds), time.thread_time)  # type: ignore[method-assign]
    trial.loop.cycle = timed(trial.loop.cycle, add_cycle, time.thread_time)  # type: ignore[method-assign]
    for _ in range(walks):
        trial.run(_STANDING)
        walker.ask(Velocity(_SPEED * walker.gait.speed[0]))
        trial.run(_WALKING)
        walker.ask(None)
        trial.run(_STOPPING)
    clock = _clock_seconds()
    return {kind: [seconds - clock for seconds in values] for kind, values in times.items()}


def main() -> None:
    """Print the table."""
    logging.disable(logging.WARNING)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*", default=["g1", "talos"])
    parser.add_argument("--walks", type=int, default=2, help="number of walks of 4 s per robot")
    words = parser.parse_args()
    print(f"{'':12}{'':24}{'median, us':>12}{'share':>8}{'p90 share':>12}{'cycles':>8}")
    for robot in words.robots:
        times = measure(robot, words.walks)
        standing = float(np.median(times[STAND]))
        for kind, values in times.items():
            if values:
                median, high = np.median(values), np.quantile(values, 0.9)
                shares = f"{median / standing:>8.2f}{high / standing:>12.2f}"
                print(f"{robot:12}{kind:24}{1e6 * median:>12.0f}{shares}{len(values):>8}")


if __name__ == "__main__":
    main()
