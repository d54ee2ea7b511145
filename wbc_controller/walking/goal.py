"""Velocity towards a pose on the ground."""

import cmath
import math
from dataclasses import dataclass

from wbc_controller.walking.footsteps import Velocity
from wbc_controller.walking.gait import SpeedLimits

#: Distance and angle at which the robot stops, m and rad: the last steps, with the feet apart, keep the place.
NEAR, NEAR_ANGLE = 0.03, 0.05
_FAR = 1.0  # distance above which the robot walks facing the goal, m; nearer, it has the heading of the goal
_STEPS = 2.0  # steps in which a small error would vanish at its velocity


@dataclass(frozen=True, slots=True)
class Goal:
    """Pose on the ground: place x + i y in m, and heading in rad, in the world."""

    place: complex
    heading: float


def velocity_to(goal: Goal, place: complex, heading: float, limits: SpeedLimits, step_time: float) -> Velocity | None:
    """Return the velocity towards a goal from the robot's place, x + i y in m, and heading, rad; None at the goal.

    An error e that decreases at v = √(a e) needs half of the acceleration a; the last steps, of the duration T in s,
    decrease it by v = e / (n T).
    """
    way = goal.place - place
    far = abs(way)
    angle = math.remainder(goal.heading - heading, math.tau)
    if far < NEAR and abs(angle) < NEAR_ANGLE:
        return None
    if far > _FAR:
        angle = math.remainder(cmath.phase(way) - heading, math.tau)
    linear = way * (_speed(far, limits.acceleration[0], step_time) / far) if far > 0.0 else 0j
    turning = math.copysign(_speed(abs(angle), limits.acceleration[2], step_time), angle)
    return Velocity(linear * cmath.rect(1.0, -heading), turning).clipped(limits)


def _speed(error: float, acceleration: float, step_time: float) -> float:
    return min(math.sqrt(acceleration * error), error / (_STEPS * step_time))
