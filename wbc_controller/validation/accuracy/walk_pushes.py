"""Pushes of a stepping robot, compared with standing."""

import math
from dataclasses import dataclass

import numpy as np

from wbc_controller.errors import WbcError
from wbc_controller.recording.report.run_data import heading
from wbc_controller.records import Array
from wbc_controller.settings.service import SensorQuality
from wbc_controller.validation.accuracy.walks import WalkTrial
from wbc_controller.walking.gait import Phase

PUSH, AFTER = 0.1, 3.0  # duration of a push, and time after it without a fall, s
LARGEST, RESOLUTION = 1.6, 1.0 / 32.0  # largest impulse per mass, m/s, and resolution of the bisection as a share of it
_STEPS = 4  # even number of steps before the push: then the left foot lifts off
#: Largest change of the velocity along x and y, m/s, and shortest and longest time between changes, s.
CHANGE, _PAUSE = 0.5, (1.0, 3.0)


@dataclass(frozen=True, slots=True)
class Push:
    """A push at the base in a direction, rad from forward to the left, at a phase of the stride of two steps.

    The phase is a share of the nominal stride from the lift-off of the left foot; None pushes a standing robot.
    """

    direction: float
    phase: float | None


def largest_impulse(robot: str, push: Push, sensors: SensorQuality, seed: int) -> float:
    """Return the largest survived impulse, N·s, by bisection."""
    low, high = 0.0, LARGEST
    while high - low > RESOLUTION * LARGEST:
        middle = 0.5 * (low + high)
        fell, mass = ends(robot, push, middle, sensors, seed)
        low, high = (low, middle) if fell else (middle, high)
    return low * mass


def ends(robot: str, push: Push, speed: float, sensors: SensorQuality, seed: int) -> tuple[str, float]:
    """Push a robot by an impulse per mass, m/s; return time and reason of its fall (empty: none), and its mass."""
    trial = WalkTrial(robot, sensors, seed)
    try:
        trial.stand()
        if push.phase is not None:
            trial.step_in_place()
            walker = trial.walker
            while not (walker.steps >= _STEPS and walker.phase is Phase.SINGLE):
                trial.run(trial.controller.period)
            trial.run(push.phase * 2.0 * walker.gait.step_time)
        direction = heading(trial.mock.plant.state()[0]) + push.direction
        _push(trial, speed * np.array([math.cos(direction), math.sin(direction)]))
        trial.run(PUSH + AFTER)
    except WbcError as error:
        return trial.when(error), trial.model.mass
    return "", trial.model.mass


def change_velocity(robot: str, sensors: SensorQuality, seed: int, seconds: float) -> str:
    """Change the velocity of a stepping robot at random, by pushes; return time and reason of its fall, or nothing."""
    trial, rng = WalkTrial(robot, sensors, seed), np.random.default_rng(seed)
    try:
        trial.stand()
        trial.step_in_place()
        left = seconds
        while left > 0.0:
            pause = min(rng.uniform(*_PAUSE), left)
            trial.run(pause)
            _push(trial, rng.uniform(-CHANGE, CHANGE, 2))
            left -= pause
    except WbcError as error:
        return trial.when(error)
    return ""


def _push(trial: WalkTrial, change: Array) -> None:
    """Push the base to change the velocity of the whole mass, (2,) in m/s."""
    force = trial.model.mass * change / PUSH
    trial.mock.plant.push(trial.model.base_link, [force[0], force[1], 0.0, 0.0, 0.0, 0.0], PUSH)
