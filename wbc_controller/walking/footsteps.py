"""Nominal steps of a velocity."""

import cmath
from dataclasses import dataclass

from wbc_controller.records import Array
from wbc_controller.walking.gait import Gait, SpeedLimits
from wbc_controller.walking.pendulum import periodic_offset
from wbc_controller.walking.swing_kernels import integrate_axis

#: Largest backward speed, as a share of the forward speed.
BACKWARD = 0.5
#: Margin of the nominal width over the smallest one, m.
_MARGIN = 0.01


@dataclass(frozen=True, slots=True)
class Velocity:
    """A velocity command: a velocity in the robot's heading, m/s, and a turning rate, rad/s."""

    linear: complex = 0j
    turning: float = 0.0

    @classmethod
    def of(cls, values: Array) -> "Velocity":
        """Return the command with the values forward, sideways and turning, (3,)."""
        forward, sideways, turning = values.tolist()
        return cls(complex(forward, sideways), turning)

    def times(self, factor: float) -> "Velocity":
        """Return a multiple of the command."""
        return Velocity(factor * self.linear, factor * self.turning)

    def clipped(self, limits: SpeedLimits) -> "Velocity":
        """Return the command within the largest speeds."""
        forward, sideways, turning = limits.speed
        ahead = max(-BACKWARD * forward, min(forward, self.linear.real))
        return Velocity(complex(ahead, _clip(self.linear.imag, sideways)), _clip(self.turning, turning))

    def towards(self, wanted: "Velocity", limits: SpeedLimits, time: float) -> "Velocity":
        """Return the command after a time, s, on the way to another one at the largest acceleration.

        A stop is faster by the factor `limits.braking`.
        """
        if wanted == self:
            return self
        time *= limits.braking if wanted == Velocity() else 1.0
        forward, sideways, turning = limits.acceleration
        change = wanted.linear - self.linear
        return Velocity(
            self.linear + complex(_clip(change.real, time * forward), _clip(change.imag, time * sideways)),
            self.turning + _clip(wanted.turning - self.turning, time * turning),
        )


def _clip(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))


@dataclass(frozen=True, slots=True)
class Stance:
    """The stance during one single support.

    Attributes:
        place: p, of the stance foot, x + i y in m in the world.
        heading: of the stance foot, rad.
        side: 1 if the swing foot is the left one, -1 for the right one.
        omega: natural frequency of the pendulum ω, 1/s.
    """

    place: complex
    heading: float
    side: int
    omega: float


@dataclass(frozen=True, slots=True)
class NominalStep:
    """Step of a periodic gait at a commanded velocity.

    Attributes:
        place: of the new foot, x + i y in m in the world.
        heading: of the new foot, rad.
        offset: of the DCM from the new foot at touchdown, x + i y in m in world axes.
    """

    place: complex
    heading: float
    offset: complex


def swing_push(gait: Gait, omega: float) -> float:
    """Return ρ, the change of the DCM at touchdown by a swing foot that moves by 1 m from rest to rest."""
    return gait.reaction / omega * integrate_axis(0.0, 0.0, 0.0, 1.0, gait.single, omega)


def nominal_step(velocity: Velocity, stance: Stance, gait: Gait, single: float) -> NominalStep:
    """Return the next step, with a single support of the given duration in s.

    The middle between the feet moves by velocity times step time in the mean heading. Sideways steps widen the stance,
    so that the inward step keeps the smallest distance between the feet.
    """
    duration = single + gait.double
    progress, turn = velocity.linear * duration, velocity.turning * duration
    width = max(gait.width, gait.least_width + _MARGIN + abs(progress.imag)) * stance.side * 1j
    before, after = cmath.rect(1.0, stance.heading), cmath.rect(1.0, stance.heading + turn)
    middle = cmath.rect(1.0, stance.heading + 0.5 * turn)
    place = stance.place + 0.5 * width * before + progress * middle + 0.5 * width * after
    push = swing_push(gait, stance.omega)
    progress = velocity.linear * gait.step_time
    offset = periodic_offset(progress, width, stance.omega, gait.single, gait.double, push) * after
    return NominalStep(place, stance.heading + turn, offset)
