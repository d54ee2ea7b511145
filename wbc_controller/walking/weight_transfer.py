"""Transfer of the weight to the foot that has landed."""

import cmath
from dataclasses import dataclass

from wbc_controller.walking.gait import Gait
from wbc_controller.walking.pendulum_kernels import later, leading, transferred

_ON_TIME, _SHORTEST = 0.03, 0.02  # error of the planned touchdown on even ground, and shortest transfer, s
#: Least errors of the DCM along and across the heading, m, for the shortest transfer.
_ASTRAY = 0.1, 0.03


@dataclass(frozen=True, slots=True)
class WeightTransfer:
    """Motion of the centre of pressure to the new stance foot, and of the DCM; points are x + i y in m."""

    dcm: complex  # reference when the motion begins
    old: complex  # place of the old stance foot
    new: complex  # place of the new one
    wait: float  # until the motion begins, s
    duration: float  # of the motion, s

    @classmethod
    def after_touchdown(
        cls, late: float, dcm: complex, goal: complex, old: complex, new: complex, heading: float, omega: float,
        gait: Gait, roughness: float,
    ) -> "WeightTransfer":  # fmt: skip
        """Plan the transfer: it begins later after an early touchdown, and ends sooner after a late one.

        `late` is the time since the planned touchdown, s, negative if early; feet are early on ground of a roughness
        above 0, at most 1 (`aim_below`). The heading is that of the new stance foot.
        """
        wait = max(0.0, -late - _ON_TIME * (1.0 - roughness))
        duration = max(gait.double - max(0.0, late - _ON_TIME), _SHORTEST)
        start = leading(goal, old, new, duration, omega)
        error = (dcm - later(start, old, omega, -wait)) * cmath.rect(1.0, -heading)
        if abs(error.real) >= _ASTRAY[0] or abs(error.imag) >= _ASTRAY[1]:
            duration, start = _SHORTEST, leading(goal, old, new, _SHORTEST, omega)
        return cls(start, old, new, wait, duration)

    def at(self, elapsed: float, omega: float) -> tuple[complex, complex, bool]:
        """Return DCM and centre of pressure at a time since touchdown, s, and True at the end."""
        time = min(elapsed - self.wait, self.duration)
        if time < 0.0:
            return later(self.dcm, self.old, omega, time), self.old, False
        dcm = transferred(self.dcm, self.old, self.new, self.duration, omega, time)
        return dcm, self.old + (self.new - self.old) * (time / self.duration), time >= self.duration
