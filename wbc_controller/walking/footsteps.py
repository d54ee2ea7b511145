"""Nominal steps of a velocity."""

from dataclasses import dataclass

from wbc_controller.records import Array
from wbc_controller.walking.footsteps_kernels import periodic_step
from wbc_controller.walking.gait import Gait, SpeedLimits

BACKWARD = 0.5  # largest backward speed, as a share of the forward speed


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
        if wanted is self or wanted == self:
            return wanted
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
    """The stance during one single support."""

    place: complex  # p, of the stance foot, x + i y in m in the world
    heading: float  # of the stance foot, rad
    side: int  # 1 if the swing foot is the left one, -1 for the right one
    omega: float  # natural frequency of the pendulum ω, 1/s


@dataclass(slots=True)  # not frozen: faster construction
class NominalStep:
    """Step of a periodic gait at a commanded velocity."""

    place: complex  # of the new foot, x + i y in m in the world
    heading: float  # of the new foot, rad
    offset: complex  # of the DCM from the new foot at touchdown, x + i y in m in world axes


def nominal_step(velocity: Velocity, stance: Stance, gait: Gait, single: float) -> NominalStep:
    """Return the next step, with a single support of the given duration in s."""
    on = stance.place, stance.heading, stance.side, stance.omega
    return NominalStep(*periodic_step(velocity.linear, velocity.turning, single, *on, gait.sizes))
