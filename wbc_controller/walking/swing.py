"""Swing foot and its planned touchdown."""

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


@dataclass(frozen=True, slots=True)
class SwingFoot:
    """Reference of the sole in the air.

    Attributes:
        motion: position, velocity and acceleration of x, y, z in m in the world and of the heading in rad, (3, 4).
    """

    motion: Array

    @classmethod
    def at_rest(cls, centre: Array, heading: float) -> "SwingFoot":
        """Return the reference of a sole at rest; centre (3,) in m, heading in rad."""
        motion = np.zeros((3, 4))
        motion[0, :3], motion[0, 3] = centre, heading
        return cls(motion)

    def moved(
        self, landing: Landing, clearance: float, elapsed: float, dt: float, descent: float = _DESCENT
    ) -> "SwingFoot":
        """Return the reference after one cycle; a late foot accelerates downwards. All times in s.

        Args:
            clearance: height of the foot above the ground at the apex, m.
            elapsed: time since lift-off.
            descent: time before the apex at which the plan changes to the ground.
        """
        out = np.empty((3, 4))
        move_foot(
            self.motion, landing.place, landing.height, landing.heading, landing.time, clearance, elapsed, dt, descent,
            out,
        )  # fmt: skip
        return SwingFoot(out)
