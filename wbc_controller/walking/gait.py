"""Phases and parameters of a biped's gait."""

from dataclasses import dataclass
from enum import Enum


class Phase(Enum):
    """A phase of walking."""

    STAND = "stand"  # both feet, no step is planned
    SHIFT = "shift"  # both feet, the weight moves over the first stance foot
    SINGLE = "single support"
    DOUBLE = "double support"
    STOP = "stop"  # both feet, the weight moves to the middle


@dataclass(frozen=True, slots=True)
class Gait:
    """Parameters of a gait.

    Attributes:
        single: nominal duration of the single support, s.
        double: duration of the double support, s.
        shift: duration of the first shift of the weight, and of the last, s.
        lowering: distance by which the centre of mass is lowered from standing, m: long steps need bent knees.
        clearance: height of the swing foot above the ground, m.
        width: nominal distance between the feet, m.
        least_width: smallest distance between the feet, m.
        length: longest step forward or backward, m.
        greatest_width: largest distance between the feet, m.
        reaction: μ, acceleration of the centre of mass by a swing foot that accelerates, c̈ = ω² (c - p) + μ ẍ.
        speed: largest velocity command forward, sideways and turning, m/s and rad/s; backward half of that forward.
        acceleration: largest rate of the velocity command, forward, sideways and turning, m/s² and rad/s².
    """

    single: float
    double: float
    shift: float
    lowering: float
    clearance: float
    width: float
    least_width: float
    length: float
    greatest_width: float
    reaction: float
    speed: tuple[float, float, float]
    acceleration: tuple[float, float, float] = (0.3, 0.3, 0.6)

    @property
    def step_time(self) -> float:
        """Nominal duration of one step, s."""
        return self.single + self.double
