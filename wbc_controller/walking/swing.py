"""Planned touchdown of a swing foot, and its motion in one cycle."""

from dataclasses import dataclass

import numpy as np

from wbc_controller.records import Array
from wbc_controller.walking.swing_kernels import move_foot

#: Time before the apex at which the plan changes from the apex to the ground, s. In a shorter time to the apex, a
#: change of the step time or of the ground by a millimetre would need a large acceleration.
_DESCENT = 0.06


@dataclass(frozen=True, slots=True)
class Landing:
    """Planned touchdown of the swing foot.

    Attributes:
        place: u, x + i y in m in the world.
        height: of the ground there, m.
        heading: of the foot, rad; less than half a turn away from the present one; 0 for a point foot.
        time: T, after lift-off, s.
    """

    place: complex
    height: float
    heading: float
    time: float


def at_rest(centre: Array, heading: float) -> Array:
    """Return the motion, (3, 4), of a sole at rest; centre (3,) in m, heading in rad."""
    return np.array([[*centre.tolist(), heading], [0.0] * 4, [0.0] * 4])


def moved(
    foot: Array, landing: Landing, clearance: float, elapsed: float, dt: float, descent: float = _DESCENT
) -> Array:
    """Return the motion of a foot, (3, 4), after one cycle; a late foot accelerates downwards. All times in s.

    Args:
        clearance: height of the foot above the ground at the apex, m.
        elapsed: time since lift-off.
        descent: time before the apex at which the plan changes to the ground.
    """
    place, height, heading, time = landing.place, landing.height, landing.heading, landing.time
    out = np.empty((3, 4))
    move_foot(foot, place, height, heading, time, clearance, elapsed, dt, descent, out)
    return out
