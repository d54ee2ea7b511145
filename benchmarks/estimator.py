"""Measure an update of the base estimate, in the cycles of a standing robot.

An update begins with the measurements of IMU and joints, and ends with pose and twist of the base. The table also
contains the whole cycle with messages, audit and status, on the memory transport. Run: python benchmarks/estimator.py
[ROBOT ...] [--seconds S]
"""

import argparse
import logging
from typing import Any

import numpy as np
from timing import timed

from wbc_controller.estimation.base_estimator import BaseEstimator
from wbc_controller.validation.accuracy.estimation_trial import EstimationTrial


def measure(robot: str, seconds: float) -> tuple[list[float], list[float], int]:
    """Return the times of updates and of whole cycles, s, and the number of contact points in the filter."""
    trial = EstimationTrial(robot, {"estimation.base_state": "imu", "mock.sensors": "good"})
    trial.stand()
    updates: list[float] = []
    cycles: list[float] = []
    loop = trial.loop
    estimator = loop.estimator
    if estimator is None or estimator.filter is None:
        raise SystemExit(f"{robot} has no base estimate")

    def update(*arguments: Any, **options: Any) -> Any:
        BaseEstimator.update(estimator, *arguments, **options)
        return estimator.base

    estimator.update = timed(update, lambda seconds, _: updates.append(seconds))  # type: ignore[method-assign]
    loop.cycle = timed(loop.cycle, lambda seconds, _: cycles.append(seconds))  # type: ignore[method-assign]
    trial.run(seconds)
    return updates, cycles, len(estimator.filter.names)


def main() -> None:
    """Print the table."""
    logging.disable(logging.WARNING)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", nargs="*", default=["g1", "talos", "go2"])
    parser.add_argument("--seconds", type=float, default=6.0, help="simulated time per robot, s")
    words = parser.parse_args()
    print(f"{'medians, us':12}{'points':>8}{'update':>8}{'p99':>8}{'cycle':>8}{'share':>8}")
    for robot in words.robots:
        updates, cycles, points = measure(robot, words.seconds)
        update, cycle, late = np.median(updates), np.median(cycles), np.quantile(updates, 0.99)
        times = "".join(f"{1e6 * each:8.0f}" for each in (update, late, cycle))
        print(f"{robot:12}{points:8}{times}{100.0 * update / cycle:6.0f} %", flush=True)


if __name__ == "__main__":
    main()
