"""The motions and targets of each robot's demo."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Move:
    """A motion of the centre of mass through points at rest."""

    name: str
    #: Pairs of the time since the start of the move, s, and the offset from the standing position, (3,) in m.
    points: tuple[tuple[float, tuple[float, float, float]], ...]
    target_rms: float  # largest root mean square of the tracking error, m

    @property
    def duration(self) -> float:
        """Length of the move, s."""
        return self.points[-1][0]

    @property
    def largest(self) -> float:
        """Largest distance from the standing position, m."""
        return max(math.dist(offset, (0.0, 0.0, 0.0)) for _, offset in self.points)


@dataclass(frozen=True, slots=True)
class Reach:
    """A frame pose task that is enabled and sent to a pose by topic."""

    task: str
    offset: tuple[float, float, float]  # offset of the target from the frame's present position, world axes, (3,) in m
    duration: float  # time allowed, s
    target: float  # largest distance at the end, m


@dataclass(frozen=True, slots=True)
class Shove:
    """A force for a tenth of a second."""

    name: str
    impulse: tuple[float, float, float]  # impulse in world axes, (3,) in N·s
    frame: str = ""  # where it acts; empty for the base link


@dataclass(frozen=True, slots=True)
class Scenario:
    """The demo of one robot."""

    stand: float = 3.0  # time of standing, s
    moves: tuple[Move, ...] = ()
    reaches: tuple[Reach, ...] = ()
    shoves: tuple[Shove, ...] = ()
    recovery: float = 2.0  # time after which the centre of mass must have returned, s
    recovery_target: float = 0.02  # largest distance then, m
    force_target: float = 0.01  # largest deviation of the sum of vertical forces from the weight, as a share of it
    #: Name of the task of the centre of mass; empty where the posture alone keeps it, as on a fixed base.
    com: str = "com"


def sway(amplitude: float, target: float) -> Move:
    """To the left, to the right and back, by an amplitude in m."""
    left, right = (0.0, amplitude, 0.0), (0.0, -amplitude, 0.0)
    return Move("sway", ((1.5, left), (4.0, right), (5.5, (0.0, 0.0, 0.0))), target)


def squat(depth: float, target: float) -> Move:
    """Down by a depth in m, and up."""
    down = (0.0, 0.0, -depth)
    return Move("squat", ((1.5, down), (2.5, down), (4.0, (0.0, 0.0, 0.0))), target)


def shoves(sideways: float, along: float, frame: str = "") -> tuple[Shove, ...]:
    """From four sides, with impulses in N·s; at the base link, or another frame."""
    return (
        Shove("shove left", (0.0, sideways, 0.0), frame),
        Shove("shove right", (0.0, -sideways, 0.0), frame),
        Shove("shove forward", (along, 0.0, 0.0), frame),
        Shove("shove backward", (-along, 0.0, 0.0), frame),
    )


SCENARIOS: dict[str, Scenario] = {
    "g1": Scenario(
        moves=(sway(0.04, 0.005), squat(0.10, 0.008)),
        reaches=(Reach("right_hand", (0.15, -0.05, 0.20), 3.0, 0.01),),
        shoves=shoves(11.0, 8.0),
    ),
    "talos": Scenario(
        moves=(sway(0.04, 0.005), squat(0.10, 0.008)),
        reaches=(Reach("right_hand", (0.10, -0.05, 0.10), 3.0, 0.01),),
        shoves=shoves(25.0, 18.0),
    ),
    "go2": Scenario(moves=(sway(0.03, 0.005), squat(0.06, 0.008)), shoves=shoves(8.0, 8.0)),
}
