"""Fuzzer of setpoints: joints keep their limits."""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from wbc_controller.controller.controller import Controller
from wbc_controller.errors import WbcError
from wbc_controller.inverse_dynamics.robot.orientation import quaternion_of
from wbc_controller.records import IN_CONTROL, Mode
from wbc_controller.settings.config import load
from wbc_controller.settings.tasks import FramePoseTask
from wbc_controller.simulation.simulation import Simulation

DURATION = 2.0  # s
MAX_EXCESS = 0.02  # largest excess over a position limit, rad or m
_IMPACT_TIME = 0.02  # time after an impact on the floor without a check, s

_log = logging.getLogger("wbc_controller")


@dataclass(slots=True)
class SetpointTrial:
    """One robot with one kind of infeasible setpoint."""

    robot: str
    number: int
    kind: str  # kind of the setpoints, a key of `KINDS`
    ended: str = ""  # code of the fault that ended the control, or empty
    seconds: float = 0.0  # s
    excess: float = -np.inf  # largest excess over a limit without impacts, rad or m; negative within the limits
    joint: str = ""
    impact: float = -np.inf  # largest excess within 20 ms after an impact
    relaxed: int = 0  # cycles
    holding: int = 0  # cycles

    @property
    def failed(self) -> bool:
        """True if a joint left its limits."""
        return not self.excess <= MAX_EXCESS

    def __str__(self) -> str:
        return f"{self.robot}, trial {self.number}: {self.kind}, {self.ended or 'active'} after {self.seconds:.1f} s"


def fuzz_setpoints(robots: Sequence[str], minutes: float, seed: int, first: int) -> Iterator[SetpointTrial]:
    """Run trials, from the number `first` on, until each robot was under control for a time."""
    level = _log.level
    _log.setLevel(logging.ERROR)  # falls and cycles without a solution are expected
    try:
        for robot in robots:
            left, number, simulation = 60.0 * minutes, first, Simulation(load(robot))
            while left > 0.0:
                trial = run_trial(simulation, robot, seed, number)
                left -= trial.seconds
                number += 1
                yield trial
    finally:
        _log.setLevel(level)


def run_trial(simulation: Simulation, robot: str, seed: int, number: int) -> SetpointTrial:
    """Run one trial from the nominal posture."""
    rng = np.random.default_rng([seed, number])
    trial = SetpointTrial(robot, number, list(KINDS)[number % len(KINDS)])
    simulation.reset()
    controller, plant = simulation.controller, simulation.plant
    impact_time, down = -np.inf, frozenset[str]()  # time of the last impact, and links on the floor
    model, request_times = controller.model, iter((0.0, rng.uniform(0.3, 1.2), np.inf))
    due = next(request_times)
    start = simulation.time
    for _ in range(round(DURATION / controller.period)):
        if simulation.time - start >= due:
            KINDS[trial.kind](controller, rng)
            due = next(request_times)
        try:
            result = controller.step(*plant.state(), simulation.time)
            if result.mode not in IN_CONTROL:
                trial.ended = result.fault.code if result.fault is not None else result.mode.value
                break
            plant.apply(result.tau)
            for _ in range(plant.steps_per_period):
                plant.step()
                before, down = down, plant.links_on_the_floor()
                if down - before:
                    impact_time = simulation.time
        except WbcError as error:  # diverged physics
            trial.ended = f"{type(error).__name__}: {error}"
            break
        q = plant.state()[0][model.q_places]
        excess = np.maximum(q - model.position_upper, model.position_lower - q)
        i = int(np.argmax(excess))
        if simulation.time - impact_time <= _IMPACT_TIME:
            trial.impact = max(trial.impact, float(excess[i]))
        elif excess[i] > trial.excess:
            trial.excess, trial.joint = float(excess[i]), model.joints[i]
        trial.relaxed += bool(result.relaxed)
        trial.holding += result.mode is Mode.HOLDING
    trial.seconds = simulation.time - start
    return trial


def _centre(controller: Controller, rng: np.random.Generator) -> None:
    com = np.array(controller.dynamics.com)
    controller.follow("com", [rng.uniform(0.2, 1.0)], [com + com[2] * rng.uniform(-0.5, 0.5, 3)])


def _squat(controller: Controller, rng: np.random.Generator) -> None:
    com = np.array(controller.dynamics.com)
    controller.follow("com", [rng.uniform(0.2, 1.0)], [com - [0.0, 0.0, com[2] * rng.uniform(0.3, 0.7)]])


def _poses(controller: Controller, rng: np.random.Generator) -> None:
    settings = controller.config.settings.tasks
    reached = [name for name, task in settings.items() if isinstance(task, FramePoseTask) and not task.enabled]
    for name in reached:
        controller.enable(name)
        place = np.array(controller.dynamics.com) + rng.uniform(-1.5, 1.5, 3)
        controller.set(name, np.concatenate([place, _turned(rng, 3.0)]), duration=rng.uniform(0.0, 0.6))
    if not reached:
        controller.set("base", _turned(rng, 1.2), duration=rng.uniform(0.1, 0.6))


def _turned(rng: np.random.Generator, most: float) -> np.ndarray:
    return quaternion_of(pin.rpy.rpyToMatrix(*rng.uniform(-most, most, 3)))


def _posture(controller: Controller, rng: np.random.Generator) -> None:
    model = controller.model
    controller.set_weight("posture", 10.0 ** rng.uniform(-2.0, 2.0))
    excess = np.where(
        rng.random(model.nj) < 0.5,
        model.position_lower - rng.uniform(0.0, 0.5, model.nj),
        model.position_upper + rng.uniform(0.0, 0.5, model.nj),
    )
    chosen = np.flatnonzero(rng.random(model.nj) < 0.3)
    controller.set("posture", {model.joints[i]: float(excess[i]) for i in chosen}, duration=rng.uniform(0.1, 0.6))


def _weights(controller: Controller, rng: np.random.Generator) -> None:
    for name, task in controller.config.settings.tasks.items():
        controller.set_weight(name, float(task.weight * 10.0 ** rng.uniform(-2.0, 2.0)))
    (_squat if rng.random() < 0.5 else _centre)(controller, rng)


def _mix(controller: Controller, rng: np.random.Generator) -> None:
    others = [_centre, _squat, _poses, _posture]
    for i in rng.choice(len(others), 2, replace=False):
        others[i](controller, rng)


#: Setpoints by kind.
KINDS: Mapping[str, Callable[[Controller, np.random.Generator], None]] = {
    send.__name__.strip("_"): send for send in (_centre, _squat, _poses, _posture, _weights, _mix)
}


def summary(trials: Sequence[SetpointTrial]) -> Iterator[str]:
    """Yield a line for each robot."""
    for robot in dict.fromkeys(trial.robot for trial in trials):
        own = [trial for trial in trials if trial.robot == robot]
        worst = max(own, key=lambda trial: trial.excess)
        yield (
            f"{robot:10} {len(own)} trials, {sum(t.seconds for t in own):.0f} s under control, "
            f"{sum(bool(t.ended) for t in own)} ended in damping; {sum(t.relaxed for t in own)} cycles relaxed, "
            f"{sum(t.holding for t in own)} held; largest excess over a position limit {max(worst.excess, 0.0):.4f} "
            f"({worst.joint}, trial {worst.number}, {worst.kind}), above {MAX_EXCESS:g} in "
            f"{sum(t.failed for t in own)} trials; within 20 ms after an impact on the floor "
            f"{max(0.0, *(t.impact for t in own)):.4f}"
        )
