"""Walks without odometry: by commands, on unknown ground, with random starts and stops."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass, field
from functools import cache
from typing import Any

import numpy as np

from wbc_controller.controller.controller import Controller
from wbc_controller.errors import ConfigurationError, WbcError, require_known
from wbc_controller.middleware.codec import velocity_message
from wbc_controller.recording.report.run_data import heading, mean_velocity
from wbc_controller.records import Array
from wbc_controller.settings.service import SensorQuality
from wbc_controller.validation.accuracy.estimation_trial import NO_CHANGES, Changes, EstimationTrial
from wbc_controller.validation.accuracy.flaws import chatter
from wbc_controller.validation.accuracy.standing import sensor_settings
from wbc_controller.walking.footsteps import BACKWARD, Velocity
from wbc_controller.walking.gait import Phase

Commands = Mapping[str, tuple[float, float, float]]  # velocities forward, to the left and turning, by name
#: Of the supplied robots, m/s and rad/s; `random` changes every `_CHANGE` seconds.
COMMANDS: Mapping[str, Commands] = {
    "g1": {
        "forward": (0.5, 0.0, 0.0), "backward": (-0.25, 0.0, 0.0), "sideways": (0.0, 0.2, 0.0), "turn": (0.0, 0.0, 0.5)
    },
    "talos": {"forward": (0.3, 0.0, 0.0)},
    "go2": {"forward": (0.8, 0.0, 0.0), "sideways": (0.0, 0.4, 0.0), "turn": (0.0, 0.0, 1.5)},
}  # fmt: skip
RANDOM = "random"
#: Time between two random velocities, between two messages, and until the speed is reached, s.
_CHANGE, _EVERY, _REACHED = 3.0, 0.1, 4.0
GROUNDS = ("flat", "uneven", "up", "down", "across", "slippery", "soft")  # grounds of the table
#: Difference in height of the cells, upwards and downwards, m, their side, m, and the angle of the slopes, rad.
UNEVENNESS, CELL, ANGLE = 0.02, 0.4, math.radians(5.0)
FRICTION, STIFFNESS = 0.4, 2.0e4  # friction of the slippery ground, and stiffness of soft ground, N/m
_AHEAD, _WIDE = 0.5, 30.0  # distance of the terrain from the start, and its size, m
#: Velocity on terrain as a share of `forward`, and to the left across a slope as a share of that forward.
SHARE, _ASIDE = 0.6, 0.35
MOST_STEPS = 3  # largest number of steps until the robot has stopped
#: Shortest and longest time of a walk, and of standing, s; longest time of a stop, s.
_WALK, _STAND, _STOP = (0.5, 4.0), (0.0, 1.0), 6.0
#: Headings of the cells of `figures_of`.
FIGURES = ("torque", "rate at touchdown", "chatter", "slip", "outside the cone")
CHATTER = 25.0  # frequency above which torques are chatter, Hz
_AT_TOUCHDOWN, _SETTLING = 0.01, 0.05  # time after a touchdown for the torque rate, and until slip counts, s


@cache
def commands_of(robot: str) -> Commands:
    """Return the commands of a robot: its largest speeds unless in `COMMANDS`; refuse one that does not walk."""
    if robot in COMMANDS:
        return COMMANDS[robot]
    walker = Controller(robot, preflight=False).walker
    if walker is None:
        raise ConfigurationError(f"{robot} cannot walk: its configuration has no section 'walking'")
    x, y, turn = walker.gait.speed
    commands = {"forward": (x, 0.0, 0.0), "backward": (-BACKWARD * x, 0.0, 0.0)}
    return {**commands, "sideways": (0.0, y, 0.0), "turn": (0.0, 0.0, turn)}


@dataclass(frozen=True, slots=True)
class WalkFigures:
    """Largest figures of a walk."""

    torque: float = 0.0  # as a share of the limit
    rate: float = 0.0  # torque rate at a touchdown, as a share of the limit
    chatter: float = 0.0  # RMS of a torque above `CHATTER`, as a share of the limit
    slip: float = 0.0  # of a foot in contact, m
    outside: float = 0.0  # excess of a commanded contact force over its cone, N or N·m


@dataclass(frozen=True, slots=True)
class Walk:
    """Figures of one walk."""

    speed: Array  # mean, forward, to the left and turning, (3,) in m/s and rad/s; NaN if random or ended
    distance: float  # path of the base, m
    drift: float  # horizontal error at the end, m
    relaxed: int  # cycles with a relaxed limit
    ended: str = ""  # time and reason of an early end
    figures: WalkFigures = field(default_factory=WalkFigures)
    lead: float = np.nan  # time from then to the ground contact of another link, s


class WalkMeter:
    """Measures the figures of a walk, cycle by cycle."""

    def __init__(self, trial: EstimationTrial) -> None:
        settings, self._trial = trial.settings, trial
        self._limits = trial.model.effort_limits
        self._step = settings.limits.torque_rate * self._limits / settings.control.rate
        self._torques: list[Array] = []
        self._since = np.inf  # cycles since the last touchdown
        self._phase: Phase | None = None
        self._placed: dict[str, tuple[int, Array]] = {}
        self._rate = self._slip = self._outside = 0.0

    def update(self) -> None:
        """Measure one cycle."""
        trial, walker = self._trial, self._trial.controller.walker
        command, solution = trial.report.command, trial.report.solution
        if walker is None or command is None or solution is None:
            return
        self._since = 0.0 if (self._phase, walker.phase) == (Phase.SINGLE, Phase.DOUBLE) else self._since + 1.0
        self._phase = walker.phase
        if self._torques and self._since < _AT_TOUCHDOWN * trial.settings.control.rate:
            self._rate = max(self._rate, float(np.max(np.abs(command.tau - self._torques[-1]) / self._step)))
        self._torques.append(np.array(command.tau))
        for name, force in solution.forces.items():
            cone = trial.controller.qp.contacts[name].cone
            self._outside = max(self._outside, float(np.max(cone @ force, initial=0.0)))
        self._follow(list(solution.forces))

    def _follow(self, contacts: list[str]) -> None:
        settled = _SETTLING * self._trial.settings.control.rate
        placed = {}
        for name in contacts:
            place = self._trial.mock.plant.foot_placement(name).translation[:2].copy()
            cycles, before = self._placed.get(name, (0, place))
            if cycles < settled:
                before = place
            self._slip = max(self._slip, float(np.linalg.norm(place - before)))
            placed[name] = cycles + 1, before
        self._placed = placed

    def figures(self) -> WalkFigures:
        """Return the figures until now."""
        if not self._torques:
            return WalkFigures()
        torques = np.array(self._torques)
        largest = float(np.max(np.abs(torques) / self._limits))
        above = chatter(torques, self._trial.settings.control.rate, self._limits, CHATTER)
        return WalkFigures(largest, self._rate, above, self._slip, self._outside)


def figures_of(walks: Sequence[Walk]) -> tuple[str, ...]:
    """Return the largest figures of walks as cells."""
    torque, rate, above, slip, outside = np.max([astuple(each.figures) for each in walks], axis=0)
    return f"{torque:.2f}", f"{rate:.2f}", f"{100.0 * above:.1f} %", f"{1e3 * slip:.1f} mm", f"{outside:.1g} N"


class WalkTrial(EstimationTrial):
    """A robot that walks on its estimate by ``cmd_vel``."""

    def __init__(
        self, robot: str, sensors: SensorQuality, seed: int, changes: Changes = NO_CHANGES, scale: float = 1.0
    ) -> None:
        """Build a robot; raise `ConfigurationError` if this fails."""
        fastest = np.max([np.abs(each) for each in commands_of(robot).values()], axis=0)
        self.fastest = scale * fastest  # forward, sideways and turning, (3,) in m/s and rad/s
        own = {"estimation.base_state": "imu", "mock.sensors": sensors, "mock.sensor_seed": seed}
        limits = {"walking.max_speed": float(max(1.0, scale) * fastest[0])}
        super().__init__(robot, {**sensor_settings(sensors), **own, **limits, **changes})
        walker = self.controller.walker
        if walker is None:
            raise ConfigurationError(f"{self.model.name} cannot walk: its configuration has no section 'walking'")
        self.walker = walker
        self.begun = math.inf  # simulated time of the start of the walk, s
        self.meter = WalkMeter(self)
        self.way: list[list[float]] = []  # time since the start, s, x and y of the base, m, and its heading, rad
        self.relaxed = 0  # cycles with a relaxed limit

    def walk(self, seconds: float, velocity: Callable[[float], Array | None]) -> None:
        """Send velocities for a time in s; raise `NoSolution` if the robot falls.

        Args:
            velocity: returns the velocity forward, to the left and turning, (3,), at a time in s; None to send nothing.
        """
        self.begun = min(self.begun, self.time)
        begin, sent = self.time, -math.inf

        def cycle() -> None:
            nonlocal sent
            if self.time - sent >= _EVERY:
                sent, wanted = self.time, velocity(self.time - begin)
                if wanted is not None:
                    self.user.send("cmd_vel", velocity_message(wanted))
            self.meter.update()
            solution, (q, _) = self.report.solution, self.mock.plant.state()
            self.relaxed += bool(solution is not None and solution.relaxed)
            self.way.append([self.time - self.begun, q[0], q[1], heading(q)])

        self.run(seconds, cycle)

    def step_in_place(self) -> None:
        """Command steps in place; zero velocity would stop."""
        self.begun = self.time
        self.walker.ask(Velocity())

    def when(self, error: Exception) -> str:
        """Return time and reason of an early end."""
        return f"{max(0.0, self.time - self.begun):.1f} s: {str(error).splitlines()[0]}"


def walk(
    robot: str,
    commanded: Sequence[float] | None,
    sensors: SensorQuality,
    seed: int,
    seconds: float,
    scale: float = 1.0,
    changes: Changes = NO_CHANGES,
) -> Walk:
    """Let a robot walk on its estimate by ``cmd_vel``, stop and stand; errors as of `WalkTrial`.

    Args:
        commanded: velocity forward, to the left and turning, (3,) in m/s and rad/s; None for random ones.
        scale: factor of the velocities.
    """
    trial = WalkTrial(robot, sensors, seed, changes, scale)
    ended, lead = "", math.nan
    rng, changes_of_velocity = np.random.default_rng(seed), math.ceil(seconds / _CHANGE)
    drawn = trial.fastest * rng.uniform([-BACKWARD, -1.0, -1.0], 1.0, (changes_of_velocity + 1, 3))

    def velocity(time: float) -> Array | None:
        if time >= seconds:
            return None
        return drawn[int(time / _CHANGE)] if commanded is None else scale * np.array(commanded)

    try:
        trial.stand()
        trial.walk(seconds + _REACHED, velocity)
        if trial.walker.moves:
            ended = "the robot did not stop"
    except WbcError as error:
        ended, lead = trial.when(error), trial.lead_time()
    way = np.array(trial.way).reshape(-1, 4)
    base = None if trial.loop.estimator is None else trial.loop.estimator.base
    drift = np.nan
    if base is not None and len(way):
        drift = float(np.linalg.norm(base[0][:2] - trial.shift[:2] - way[-1, 1:3]))
    speed = np.full(3, np.nan) if ended or commanded is None else mean_velocity(way, _REACHED, seconds)
    distance = float(np.linalg.norm(np.diff(way[:, 1:3], axis=0), axis=1).sum())
    return Walk(speed, distance, drift, trial.relaxed, ended, trial.meter.figures(), lead)


def _flat_start(height: float) -> dict[str, Any]:
    return {"position": [-2.0, 0.0, height], "size": [2.0 + _AHEAD, _WIDE, height]}


def _slope(height: float, pitch: float) -> dict[str, Any]:
    return {"position": [_AHEAD, 0.0, height], "size": [_WIDE, _WIDE, 0.2], "rpy": [0.0, pitch, 0.0]}


def terrain_of(ground: str, seed: int) -> Mapping[str, Any]:
    """Return the settings of the mock robot for a ground, by dotted key; raise `ConfigurationError` if unknown."""
    cells = {"position": [_AHEAD, 0.0, UNEVENNESS], "size": [12.0, 8.0, 0.1], "unevenness": UNEVENNESS, "cell": CELL}
    across = {"position": [0.0, 0.25, 0.0], "size": [_WIDE, 2.0 * _WIDE, 0.2], "rpy": [0.0, -ANGLE, 0.5 * math.pi]}
    grounds: dict[str, dict[str, Any]] = {
        "flat": {},
        "uneven": {"mock.terrain": {"start": _flat_start(UNEVENNESS), "cells": {**cells, "seed": seed}}},
        "up": {"mock.terrain": {"slope": _slope(0.0, -ANGLE)}},
        "down": {"mock.terrain": {"start": _flat_start(2.0), "slope": _slope(2.0, ANGLE)}},
        "across": {"mock.terrain": {"slope": across}},
        "slippery": {"mock.friction": FRICTION},
        "soft": {"mock.terrain": {"mat": {**_flat_start(0.1), "size": [_WIDE, _WIDE, 0.1], "stiffness": STIFFNESS}}},
    }
    require_known(ground, grounds, "unknown ground")
    return grounds[ground]


def walk_on(robot: str, ground: str, sensors: SensorQuality, seed: int, seconds: float) -> Walk:
    """Walk onto a ground, stop and stand; across a slope also sideways."""
    ahead = commands_of(robot)["forward"][0]
    commanded = ahead, _ASIDE * ahead if ground == "across" else 0.0, 0.0
    return walk(robot, commanded, sensors, seed, seconds, SHARE, terrain_of(ground, seed))


@dataclass(frozen=True, slots=True)
class Starts:
    """Starts and stops of one robot."""

    steps: tuple[int, ...]  # steps of each stop
    ended: str = ""  # time and reason of an early end


def start_and_stop(robot: str, sensors: SensorQuality, seed: int, count: int) -> Starts:
    """Start at random velocities and stop after random times; errors as of `walk`."""
    trial, rng = WalkTrial(robot, sensors, seed), np.random.default_rng(seed)
    steps: list[int] = []
    try:
        trial.stand()
        for _ in range(count):
            wanted = trial.fastest * rng.uniform([-BACKWARD, -1.0, -1.0], 1.0)
            trial.walk(rng.uniform(*_WALK), lambda time, wanted=wanted: wanted)  # type: ignore[misc]
            before, stopped = trial.walker.steps, trial.time
            while trial.walker.moves and trial.time - stopped < _STOP:
                trial.walk(trial.controller.period, lambda time: np.zeros(3))
            if trial.walker.moves:
                return Starts(tuple(steps), f"{trial.time - trial.begun:.1f} s: the robot did not stop")
            steps.append(trial.walker.steps - before)
            trial.walk(rng.uniform(*_STAND), lambda time: None)
    except WbcError as error:
        return Starts(tuple(steps), trial.when(error))
    return Starts(tuple(steps))
