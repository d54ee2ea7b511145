"""Commands of velocities, goals and footsteps, and the nominal step of a velocity."""

import cmath
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from wbc_controller.errors import InputRefused
from wbc_controller.records import Array
from wbc_controller.walking.footsteps_kernels import periodic_step, swing_push
from wbc_controller.walking.gait import Gait, SpeedLimits
from wbc_controller.walking.pendulum_kernels import periodic_offset, previous_offset

BACKWARD = 0.5  # largest backward speed, as a share of the forward speed
MAX_TURN = 0.5  # largest angle between the feet, rad
#: Distance and angle at which the robot stops, m and rad: the last steps, with the feet apart, keep the place.
NEAR, NEAR_ANGLE = 0.03, 0.05
_FAR = 1.0  # distance above which the robot walks facing the goal, m; nearer, it has the heading of the goal
_STEPS = 2.0  # steps in which a small error would vanish at its velocity
_AHEAD = 3  # steps that determine the next one: each later one counts by e^{-ωT}, a tenth
_NAMES = {1: "left", -1: "right"}


@dataclass(frozen=True, slots=True)
class Velocity:
    """A velocity command: a velocity in the robot's heading, m/s, and a turning rate, rad/s."""

    linear: complex = 0j
    turning: float = 0.0

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


@dataclass(frozen=True, slots=True)
class Footstep:
    """Wanted pose of a sole on the ground: side (1 left, -1 right), place x + i y in m, heading in rad."""

    side: int
    place: complex
    heading: float


def planned(
    poses: Array, feet: Mapping[int, tuple[complex, float]], first: int | None, gait: Gait
) -> tuple[Footstep, ...]:
    """Return the footsteps with poses of alternating soles.

    Args:
        poses: x, y in m and heading in rad, (n, 3).
        feet: place and heading of both feet before the first step, by side.
        first: side of the first step; None for the foot that is nearer to it.

    Raises:
        InputRefused: if a step is out of reach, or its foot would overlap the other one.
    """
    places = [complex(x, y) for x, y, _ in poses]
    if first is None:
        first = min(feet, key=lambda side: abs(feet[side][0] - places[0]))
    steps = [Footstep(-first if i % 2 else first, places[i], float(heading)) for i, heading in enumerate(poses[:, 2])]
    place, heading = feet[-first]
    for number, step in enumerate(steps, 1):
        local, turn = (step.place - place) * cmath.rect(1.0, -heading), math.remainder(step.heading - heading, math.tau)
        ahead, width = local.real, step.side * local.imag
        reached = abs(ahead) <= gait.length and gait.least_width <= width <= gait.greatest_width
        if not (reached and abs(turn) <= MAX_TURN):
            raise InputRefused(
                f"step {number} of {len(steps)} ({_NAMES[step.side]} foot) is {ahead:.3f} m ahead and {width:.3f} m "
                f"beside the {_NAMES[-step.side]} foot, turned by {turn:.2f} rad; valid: -{gait.length:.3f} to "
                f"{gait.length:.3f} m ahead, {gait.least_width:.3f} to {gait.greatest_width:.3f} m beside, "
                f"{-MAX_TURN:g} to {MAX_TURN:g} rad"
            )
        place, heading = step.place, step.heading
    return tuple(steps)


def step_towards(steps: Sequence[Footstep], stance: Stance, gait: Gait) -> NominalStep:
    """Return the nominal step to the first planned footstep; after the last one the robot steps in place.

    The offset of the DCM follows backwards, from the step in place after the last considered one.
    """
    step, *later = steps[:_AHEAD]
    last = later[-1] if later else step
    following = -1j * last.side * gait.width * cmath.rect(1.0, last.heading)
    push = swing_push(gait.reaction, gait.single, stance.omega)
    offset = periodic_offset(0.0, following, stance.omega, gait.single, gait.double, push)
    places = [stance.place, step.place, *(each.place for each in later)]
    for i in range(len(places) - 1, 0, -1):
        vector = places[i] - places[i - 1]
        offset = previous_offset(offset, vector, following, stance.omega, gait.single, gait.double, push)
        following = vector
    return NominalStep(step.place, step.heading, offset)
