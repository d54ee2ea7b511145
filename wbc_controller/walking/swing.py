"""Motion of the swing foot, replanned in every cycle."""

import math
from dataclasses import dataclass

from wbc_controller.records import Array

#: Share of the step at which the foot is highest.
APEX = 0.45
#: Speed at touchdown, m/s.
TOUCHDOWN_SPEED = 0.1
#: Downward acceleration and speed of a late foot, m/s² and m/s.
_LATE_ACCELERATION, LATE_SPEED = 10.0, 0.5
#: Time before the apex at which the plan changes from the apex to the ground, s. In a shorter time to the apex, a
#: change of the step time or of the ground by a millimetre would need a large acceleration.
_DESCENT = 0.06
#: Shortest remaining time of a new plan, s.
_SHORTEST = 0.0005


@dataclass(frozen=True, slots=True)
class Axis:
    """One coordinate of a reference, with its rates."""

    position: float
    velocity: float = 0.0
    acceleration: float = 0.0

    def moved(self, goal: float, speed: float, left: float, dt: float) -> "Axis":
        """Return the coordinate after `dt` on the quintic to a goal; all times in s.

        Args:
            speed: velocity at the goal, without acceleration.
            left: time until the goal.
        """
        if left <= _SHORTEST:
            return Axis(self.position)
        t, x, v, a = min(dt, left), self.position, self.velocity, self.acceleration
        c3, c4, c5 = self._quintic(goal, speed, left)
        return Axis(
            x + t * (v + t * (0.5 * a + t * (c3 + t * (c4 + t * c5)))),
            v + t * (a + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5))),
            a + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5)),
        )

    def growing(self, goal: float, left: float, omega: float) -> float:
        """Return ∫ e^{ω(T - t)} ẍ(t) dt in m/s over the quintic to rest at a goal, in the remaining time T.

        With I_k = ∫ e^{ω(T - t)} tᵏ dt: I_0 = (e^{ωT} - 1) / ω and I_k = (k I_{k-1} - Tᵏ) / ω.
        """
        if left <= _SHORTEST:
            return 0.0
        c3, c4, c5 = self._quintic(goal, 0.0, left)
        i0 = (math.exp(omega * left) - 1.0) / omega
        i1 = (i0 - left) / omega
        i2 = (2.0 * i1 - left**2) / omega
        i3 = (3.0 * i2 - left**3) / omega
        return self.acceleration * i0 + 6.0 * c3 * i1 + 12.0 * c4 * i2 + 20.0 * c5 * i3

    def _quintic(self, goal: float, speed: float, left: float) -> tuple[float, float, float]:
        """Return the coefficients of t³, t⁴ and t⁵ on the way to a goal, reached at a speed without acceleration."""
        T, x, v, a = left, self.position, self.velocity, self.acceleration
        d = goal - x - v * T - 0.5 * a * T * T
        e = (speed - v - a * T) * T
        f = -a * T * T
        return (
            (10.0 * d - 4.0 * e + 0.5 * f) / T**3,
            (-15.0 * d + 7.0 * e - f) / T**4,
            (6.0 * d - 3.0 * e + 0.5 * f) / T**5,
        )


@dataclass(frozen=True, slots=True)
class SwingFoot:
    """Reference of the sole in the air: x, y, z in m in the world, and its heading in rad."""

    x: Axis
    y: Axis
    z: Axis
    heading: Axis

    @classmethod
    def at_rest(cls, centre: Array, heading: float) -> "SwingFoot":
        """Return the reference of a sole at rest; centre (3,) in m, heading in rad."""
        x, y, z = centre.tolist()
        return cls(Axis(x), Axis(y), Axis(z), Axis(heading))

    @property
    def place(self) -> complex:
        """Place above the ground, x + i y in m."""
        return complex(self.x.position, self.y.position)

    def growing(self, place: complex, left: float, omega: float) -> complex:
        """Return ∫ e^{ω(T - t)} ẍ(t) dt in m/s of the horizontal motion to a place, in the remaining time T."""
        return complex(self.x.growing(place.real, left, omega), self.y.growing(place.imag, left, omega))

    @property
    def acceleration(self) -> complex:
        """Horizontal acceleration, x + i y in m/s²."""
        return complex(self.x.acceleration, self.y.acceleration)

    def moved(
        self,
        landing: "Landing",
        clearance: float,
        elapsed: float,
        duration: float,
        dt: float,
        descent: float = _DESCENT,
    ) -> "SwingFoot":
        """Return the reference after one cycle; a late foot accelerates downwards. All times in s.

        Args:
            clearance: height of the foot above the ground at the apex, m.
            elapsed: time since lift-off.
            duration: of the swing.
            descent: time before the apex at which the plan changes to the ground.
        """
        left, top = duration - elapsed, APEX * duration
        if top - elapsed > descent:
            z = self.z.moved(landing.height + clearance, 0.0, top - elapsed, dt)
        elif left > _SHORTEST:
            z = self.z.moved(landing.height, -TOUCHDOWN_SPEED, left, dt)
        else:
            speed = max(min(self.z.velocity, -TOUCHDOWN_SPEED) - _LATE_ACCELERATION * dt, -LATE_SPEED)
            z = Axis(self.z.position + speed * dt, speed, -_LATE_ACCELERATION if speed > -LATE_SPEED else 0.0)
        return SwingFoot(
            self.x.moved(landing.place.real, 0.0, left, dt),
            self.y.moved(landing.place.imag, 0.0, left, dt),
            z,
            self.heading.moved(landing.heading, 0.0, left, dt),
        )


@dataclass(frozen=True, slots=True)
class Landing:
    """Planned touchdown of the swing foot.

    Attributes:
        place: x + i y in m in the world.
        height: of the ground there, m.
        heading: of the foot, rad; less than half a turn away from the present one; 0 for a point foot.
    """

    place: complex
    height: float
    heading: float
