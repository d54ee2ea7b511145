"""Placement of the feet in a trot.

Two point feet exert no moment about the line between them. Along the line the controller accelerates the body; across
it the body falls like the linear inverted pendulum, ξ̇ = ω (ξ - p). The place of the next line controls it.
"""

import math
from dataclasses import dataclass

from wbc_controller.walking.pendulum import periodic_offset


@dataclass(frozen=True, slots=True)
class SupportLine:
    """The line through the two stance feet.

    Attributes:
        point: p, a point of the line, x + i y in m.
        along: unit vector t of the line.
    """

    point: complex
    along: complex

    @classmethod
    def through(cls, a: complex, b: complex) -> "SupportLine":
        """Return the line through two different points."""
        return cls(a, (b - a) / abs(b - a))

    def later(self, dcm: complex, velocity: complex, omega: float, time: float) -> complex:
        """Return the DCM after a time t in s: ξ + (v·t) t t along the line, p + (ξ - p) e^{ωt} across it.

        The controller keeps the component of the commanded velocity v, in m/s, along the line.
        """
        across = 1j * self.along
        distance = ((dcm - self.point) * across.conjugate()).real
        forward = (velocity * self.along.conjugate()).real
        return dcm + forward * time * self.along + distance * (math.exp(omega * time) - 1.0) * across


def middle_of_pair(dcm: complex, velocity: complex, omega: float, duration: float) -> complex:
    """Return the middle between the new feet for a DCM ξ at their touchdown: ξ - v T / (e^{ωT} - 1).

    This is the offset of the gait that repeats the progress v T, without width (`periodic_offset`).

    Args:
        velocity: v, commanded velocity in the world during the stance, m/s.
        duration: T, from this touchdown to the next, s.
    """
    return dcm - periodic_offset(velocity * duration, 0j, omega, duration, 0.0, 0.0)
