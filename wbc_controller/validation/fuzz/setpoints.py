"""The fuzzer of setpoints: joints stay within their limits with any setpoint and relaxation.

Each trial asks a standing robot for what it cannot do, and then again while it tries or falls. A trial ends with its
time, or where the controller has left its active mode: then the supervisor damps.

Where a hand or a knee strikes the floor, the impact turns joints within one step of the physics, between two cycles.
How far it drives them into their stops no torque decides: that is measured apart.
"""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from wbc_controller.controller.controller import Controller
from wbc_controller.errors import WbcError
from wbc_controller.inverse_dynamics.robot.orientation import quaternion_of
from wbc_controller.records import Mode
from wbc_controller.settings import FramePoseTask
from wbc_controller.settings.config import load
from wbc_controller.simulation.simulation import Simulation

#: Simulated time of a trial, s.
DURATION = 2.0
#: How far a joint may be beyond its position limit, rad or m.
BEYOND = 0.02
#: Time after a link has struck the floor for which its impact moves the joints, s: a wrist that it flings with 23 rad/s
#: crosses 0.3 rad meanwhile, whatever its motor does, and the stops give way for a few steps.
_IMPACT = 0.02
#: Modes in which torques come from solutions.
_IN_CONTROL = (Mode.ACTIVE, Mode.HOLDING)

_log = logging.getLogger("wbc_controller")


@dataclass(slots=True)
class SetpointTrial:
    """One robot, asked for one kind of impossible things."""

    robot: str
    number: int  # of the trial: with the seed it decides everything
    kind: str  # of the setpoints, a key of `KINDS`
    ended: str = ""  # code of the fault that ended the control; empty where none did
    seconds: float = 0.0  # simulated time under control, s
    # how far a joint was beyond its position limit at most, rad or m, but for impacts; negative where none was
    beyond: float = -np.inf
    joint: str = ""
    impact: float = -np.inf  # how far one was within 20 ms after a link had struck the floor, likewise
    relaxed: int = 0  # number of cycles in which constraints were relaxed
    holding: int = 0  # number of cycles without a solution

    @property
    def kept(self) -> bool:
        """Whether the joints kept their limits."""
        return self.beyond <= BEYOND


def fuzz_setpoints(
    robots: Sequence[str],
    minutes: float,
    seed: int,
    *,
    first: int = 0,
    progress: Callable[[SetpointTrial], None] = lambda trial: None,
) -> list[SetpointTrial]:
    """Run trials until each robot was under control for a time.

    Raises:
        ConfigurationError: where there is no such robot.
    """
    level, trials = _log.level, list[SetpointTrial]()
    _log.setLevel(logging.ERROR)  # falls and cycles without a solution are expected
    try:
        for robot in robots:
            left, number, simulation = 60.0 * minutes, first, Simulation(load(robot))
            while left > 0.0:
                trials.append(run_trial(simulation, robot, seed, number))
                left -= trials[-1].seconds
                number += 1
                progress(trials[-1])
    finally:
        _log.setLevel(level)
    return trials


def run_trial(simulation: Simulation, robot: str, seed: int, number: int) -> SetpointTrial:
    """Run one trial, which begins anew from the nominal posture."""
    rng = np.random.default_rng([seed, number])
    trial = SetpointTrial(robot, number, list(KINDS)[number % len(KINDS)])
    simulation.reset()
    controller, plant = simulation.controller, simulation.plant
    struck, down = -np.inf, frozenset[str]()  # when a link struck the floor last, and the links on it
    model, asks = controller.model, iter((0.0, rng.uniform(0.3, 1.2), np.inf))
    due = next(asks)
    start = simulation.time
    for _ in range(round(DURATION / controller.period)):
        if simulation.time - start >= due:
            KINDS[trial.kind](controller, rng)
            due = next(asks)
        try:
            result = controller.step(*plant.state(), simulation.time)
            if result.mode not in _IN_CONTROL:
                trial.ended = result.fault.code if result.fault is not None else result.mode.value
                break
            plant.apply(result.tau)
            for _ in range(plant.steps_per_period):
                plant.step()
                before, down = down, plant.links_on_the_floor()
                if down - before:
                    struck = simulation.time
        except WbcError as error:  # the physics has diverged
            trial.ended = f"{type(error).__name__}: {error}"
            break
        q = plant.state()[0][model.q_places]
        beyond = np.maximum(q - model.position_upper, model.position_lower - q)
        i = int(np.argmax(beyond))
        if simulation.time - struck <= _IMPACT:
            trial.impact = max(trial.impact, float(beyond[i]))
        elif beyond[i] > trial.beyond:
            trial.beyond, trial.joint = float(beyond[i]), model.joints[i]
        trial.relaxed += bool(result.relaxed)
        trial.holding += result.mode is Mode.HOLDING
    trial.seconds = simulation.time - start
    return trial


def _centre(controller: Controller, rng: np.random.Generator) -> None:
    """The centre of mass, half of its height away in any direction."""
    com = np.array(controller.dynamics.com)
    controller.follow("com", [rng.uniform(0.2, 1.0)], [com + com[2] * rng.uniform(-0.5, 0.5, 3)])


def _squat(controller: Controller, rng: np.random.Generator) -> None:
    """The centre of mass, down to under a third of its height."""
    com = np.array(controller.dynamics.com)
    controller.follow("com", [rng.uniform(0.2, 1.0)], [com - [0.0, 0.0, com[2] * rng.uniform(0.3, 0.7)]])


def _poses(controller: Controller, rng: np.random.Generator) -> None:
    """Frames that are enabled by users, 1.5 m away and turned at will; the base's orientation where there are none."""
    settings = controller.config.settings.tasks
    reached = [name for name, task in settings.items() if isinstance(task, FramePoseTask) and not task.enabled]
    for name in reached:
        controller.enable(name)
        place = np.array(controller.dynamics.com) + rng.uniform(-1.5, 1.5, 3)
        controller.set(name, np.concatenate([place, _turned(rng, 3.0)]), duration=rng.uniform(0.0, 0.6))
    if not reached:
        controller.set("base", _turned(rng, 1.2), duration=rng.uniform(0.1, 0.6))


def _turned(rng: np.random.Generator, most: float) -> np.ndarray:
    """A unit quaternion (x, y, z, w) with random roll, pitch and yaw of up to `most` rad."""
    return quaternion_of(pin.rpy.rpyToMatrix(*rng.uniform(-most, most, 3)))


def _posture(controller: Controller, rng: np.random.Generator) -> None:
    """A third of the joints up to 0.5 rad beyond their limits, with any weight."""
    model = controller.model
    controller.set_weight("posture", 10.0 ** rng.uniform(-2.0, 2.0))
    beyond = np.where(
        rng.random(model.nj) < 0.5,
        model.position_lower - rng.uniform(0.0, 0.5, model.nj),
        model.position_upper + rng.uniform(0.0, 0.5, model.nj),
    )
    chosen = np.flatnonzero(rng.random(model.nj) < 0.3)
    controller.set("posture", {model.joints[i]: float(beyond[i]) for i in chosen}, duration=rng.uniform(0.1, 0.6))


def _weights(controller: Controller, rng: np.random.Generator) -> None:
    """All weights at 10⁻² to 10² of the configuration's, and the centre of mass away or down."""
    for name, task in controller.config.settings.tasks.items():
        controller.set_weight(name, float(task.weight * 10.0 ** rng.uniform(-2.0, 2.0)))
    (_squat if rng.random() < 0.5 else _centre)(controller, rng)


def _mix(controller: Controller, rng: np.random.Generator) -> None:
    """Two of the others at once."""
    others = [_centre, _squat, _poses, _posture]
    for i in rng.choice(len(others), 2, replace=False):
        others[i](controller, rng)


#: What is asked for, by kind.
KINDS: Mapping[str, Callable[[Controller, np.random.Generator], None]] = {
    "centre": _centre,
    "squat": _squat,
    "poses": _poses,
    "posture": _posture,
    "weights": _weights,
    "mix": _mix,
}


def summary(trials: Sequence[SetpointTrial]) -> Iterator[str]:
    """A line for each robot."""
    for robot in dict.fromkeys(trial.robot for trial in trials):
        own = [trial for trial in trials if trial.robot == robot]
        worst = max(own, key=lambda trial: trial.beyond)
        yield (
            f"{robot:10} {len(own)} trials, {sum(t.seconds for t in own):.0f} s under control, "
            f"{sum(bool(t.ended) for t in own)} ended in damping; {sum(t.relaxed for t in own)} cycles relaxed, "
            f"{sum(t.holding for t in own)} held; beyond a position limit by {max(worst.beyond, 0.0):.4f} at most "
            f"({worst.joint}, trial {worst.number}, {worst.kind}), by over {BEYOND:g} in "
            f"{sum(not t.kept for t in own)} trials; within 20 ms after a link struck the floor by "
            f"{max(0.0, *(t.impact for t in own)):.4f}"
        )
