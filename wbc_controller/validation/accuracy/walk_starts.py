"""Random starts and stops: steps until the robot has stopped."""

from dataclasses import dataclass

import numpy as np

from wbc_controller.errors import WbcError
from wbc_controller.settings.service import SensorQuality
from wbc_controller.validation.accuracy.walks import WalkTrial
from wbc_controller.walking.footsteps import BACKWARD

#: Largest number of steps until the robot has stopped.
MOST_STEPS = 3
#: Shortest and longest time of a walk, and of standing, s; longest time of a stop, s.
_WALK, _STAND, _STOP = (0.5, 4.0), (0.0, 1.0), 6.0


@dataclass(frozen=True, slots=True)
class Starts:
    """Starts and stops of one robot."""

    seed: int
    steps: tuple[int, ...]  # steps of each stop
    ended: str = ""  # time and reason of an early end


def start_and_stop(robot: str, sensors: SensorQuality, seed: int, count: int) -> Starts:
    """Start at random velocities and stop after random times.

    Raises:
        ConfigurationError: if the robot cannot be controlled or simulated.
    """
    trial, rng = WalkTrial(robot, sensors, seed), np.random.default_rng(seed)
    steps: list[int] = []
    walker = trial.controller.walker
    try:
        trial.stand()
        for _ in range(count):
            wanted = trial.fastest * rng.uniform([-BACKWARD, -1.0, -1.0], 1.0)
            trial.walk(rng.uniform(*_WALK), lambda time, wanted=wanted: wanted)  # type: ignore[misc]
            before, stopped = 0 if walker is None else walker.steps, trial.time
            while not trial.stands and trial.time - stopped < _STOP:
                trial.walk(trial.controller.period, lambda time: np.zeros(3))
            if walker is None or not trial.stands:
                return Starts(seed, tuple(steps), f"{trial.time - trial.begun:.1f} s: the robot did not stop")
            steps.append(walker.steps - before)
            trial.walk(rng.uniform(*_STAND), lambda time: None)
    except WbcError as error:
        return Starts(seed, tuple(steps), trial.when(error))
    return Starts(seed, tuple(steps))
