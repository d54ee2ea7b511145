"""Walks of robots without odometry: the speed that they reach, the drift of the estimate, and falls."""

import math
from dataclasses import dataclass

import numpy as np

from wbc_controller.errors import WbcError
from wbc_controller.middleware.codec import message
from wbc_controller.middleware.odometry import vector
from wbc_controller.records import Array
from wbc_controller.settings.service import SensorQuality
from wbc_controller.validation.accuracy.estimation_trial import EstimationTrial
from wbc_controller.validation.accuracy.standing import sensor_settings
from wbc_controller.walking.footsteps import BACKWARD

#: Velocities forward, to the left and turning, m/s and rad/s, by name; `random` changes every `_CHANGE` seconds.
COMMANDS: dict[str, dict[str, tuple[float, float, float]]] = {
    "g1": {
        "forward": (0.5, 0.0, 0.0), "backward": (-0.25, 0.0, 0.0), "sideways": (0.0, 0.2, 0.0), "turn": (0.0, 0.0, 0.5)
    },
    "talos": {"forward": (0.3, 0.0, 0.0)},
}  # fmt: skip
RANDOM = "random"
#: Time between two random velocities, between two messages, and until the speed is reached, s.
_CHANGE, _EVERY, _REACHED = 3.0, 0.1, 4.0


@dataclass(frozen=True, slots=True)
class Walk:
    """Figures of one walk."""

    seed: int
    speed: Array  # mean velocity forward, to the left and turning, (3,) in m/s and rad/s; NaN if it is random or ended
    distance: float  # length of the way of the base, m
    drift: float  # horizontal error of the estimated position at the end, m
    relaxed: int  # number of cycles with a relaxed limit
    ended: str = ""  # reason of an early end; empty if there was none
    lead: float = np.nan  # time from the early end to the contact of another link with the ground, s


def walk(robot: str, command: str, sensors: SensorQuality, seed: int, seconds: float, scale: float = 1.0) -> Walk:
    """Let a robot walk on its estimate by messages on ``cmd_vel``, stop and stand.

    Args:
        command: a name of `COMMANDS`, or `RANDOM`.
        seed: of sensors and random velocities.
        seconds: time of the walk, s.
        scale: factor of the velocities.

    Raises:
        ConfigurationError: if the robot cannot be controlled or simulated.
    """
    fastest = np.max([np.abs(each) for each in COMMANDS[robot].values()], axis=0)
    own = {"estimation.base_state": "imu", "mock.sensors": sensors, "mock.sensor_seed": seed}
    limits = {"walking.max_speed": float(fastest[0])}
    trial = EstimationTrial(robot, {**sensor_settings(sensors), **own, **limits})
    rng = np.random.default_rng(seed)
    begun, sent, ways, relaxed, ended, lead = 0.0, -1.0e9, [], 0, "", math.nan
    velocity = np.zeros(3)

    def each() -> None:
        nonlocal sent, velocity, relaxed
        since = trial.time - begun
        if since < seconds and trial.time - sent >= _EVERY:
            if command != RANDOM:
                velocity = scale * np.array(COMMANDS[robot][command])
            elif math.floor(since / _CHANGE) != math.floor((sent - begun) / _CHANGE):
                velocity = scale * fastest * rng.uniform([-BACKWARD, -1.0, -1.0], 1.0)
            sent = trial.time
            trial.user.send("cmd_vel", _twist(velocity))
        solution = trial.report.solution
        relaxed += bool(solution is not None and solution.relaxed)
        q, _ = trial.mock.plant.state()
        ways.append([trial.time - begun, q[0], q[1], _heading(q)])

    try:
        trial.stand()
        begun = trial.time
        trial.run(seconds + _REACHED, each)
        if trial.controller.walker is None or trial.controller.walker.moves:
            ended = "the robot did not stop"
    except WbcError as error:
        ended, lead = str(error), trial.lead_time()
    if not ways:
        return Walk(seed, np.full(3, np.nan), 0.0, np.nan, relaxed, ended, lead)
    way = np.array(ways)
    base = None if trial.estimator is None else trial.estimator.base
    drift = np.nan if base is None else float(np.linalg.norm(base[0][:2] - trial.shift[:2] - way[-1, 1:3]))
    speed = np.full(3, np.nan) if ended or command == RANDOM else mean_velocity(way, _REACHED, seconds)
    distance = float(np.linalg.norm(np.diff(way[:, 1:3], axis=0), axis=1).sum())
    return Walk(seed, speed, distance, drift, relaxed, ended, lead)


def mean_velocity(way: Array, begin: float, end: float) -> Array:
    """Return the mean velocity in the heading between two times, (3,) in m/s and rad/s.

    Args:
        way: times in s, x and y in m and heading in rad, (n, 4).
        begin: s.
        end: s.
    """
    part = way[(way[:, 0] >= begin) & (way[:, 0] <= end)]
    heading = np.unwrap(part[:, 3])
    steps = np.diff(part[:, 1] + 1j * part[:, 2]) * np.exp(-0.5j * (heading[1:] + heading[:-1]))
    moved = steps.sum()
    change = np.array([moved.real, moved.imag, heading[-1] - heading[0]])
    return change / float(part[-1, 0] - part[0, 0])


def _heading(q: Array) -> float:
    """Return the heading of a floating base, rad."""
    x, y, z, w = q[3:7].tolist()
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def _twist(velocity: Array) -> object:
    """Make a geometry_msgs/Twist from a velocity forward, to the left and turning, (3,)."""
    linear, angular = np.array([velocity[0], velocity[1], 0.0]), np.array([0.0, 0.0, velocity[2]])
    return message("geometry_msgs/msg/Twist", linear=vector(linear), angular=vector(angular))
