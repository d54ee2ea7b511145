"""Adaptation of place and time of a step.

At the end of the single support after the time T, the DCM is at

    ξ_T = p + (ξ - p) e^{ω (T - t)} + (μ/ω) ∫ e^{ω (T - s)} ẍ ds

with the acceleration ẍ of the swing foot (`reaction`). The new foot is placed at u, and b = ξ_T - u is the offset from
which the next step starts. Like Khadiv et al., the walker minimizes

    w_u |u - u*|² + w_b |b - b*|² + w_T (e^{ω (T - T*)} - 1)²

with the nominal u*, b* and T*, and u within the reach of the leg. For a given T, u follows in closed form. The cost is
convex in e^{ωT}, so one step of T towards lower cost per cycle finds the minimum; then T changes continuously. After an
outward push, the swing foot lands early and near the stance foot, so that the stance leg can step.

Source: Khadiv, Herzog, Moosavian and Righetti, Walking control based on step timing adaptation, IEEE T-RO 36, 2020.
"""

import cmath
import math
from dataclasses import dataclass

from wbc_controller.walking.footsteps import NominalStep, Stance
from wbc_controller.walking.gait import Gait
from wbc_controller.walking.pendulum import later
from wbc_controller.walking.swing import Axis, SwingFoot

#: Weights of place and offset, 1/m², and of time.
W_PLACE, W_OFFSET, W_TIME = 1.0, 200.0, 0.02
#: Shortest and longest single support, as shares of the nominal one.
SHORTEST, LONGEST = 0.25, 1.6
#: Rate of change of the step time, and the one of a large decrease.
TIME_RATE, SHORTENING = 1.0, 10.0
#: Shortest remaining time of an adaptation, s.
_AHEAD = 0.04
#: Largest mean speed of the swing foot, m/s, and vertical acceleration, m/s².
FOOT_SPEED, FOOT_ACCELERATION = 2.5, 20.0


@dataclass(frozen=True, slots=True)
class StepTarget:
    """Place and time of a touchdown.

    Attributes:
        place: u, x + i y in m in the world.
        offset: b, m.
        time: T, duration of the single support, s.
    """

    place: complex
    offset: complex
    time: float


def adapted(
    before: StepTarget, nominal: NominalStep, stance: Stance, gait: Gait, dcm: complex, swing: SwingFoot,
    elapsed: float, dt: float, ground: float,
) -> StepTarget:  # fmt: skip
    """Return the target of the step for the measured DCM.

    Args:
        before: target of the last cycle.
        dcm: ξ, measured.
        elapsed: t, since the start of the single support, s.
        dt: time since the last cycle, s.
        ground: height of the ground, m.
    """
    earliest = max(SHORTEST * gait.single, elapsed + max(_AHEAD, descent_time(swing.z, ground)))
    latest = max(LONGEST * gait.single, earliest)
    rates = (0.0, -TIME_RATE, TIME_RATE, -SHORTENING)
    times = [max(earliest, min(latest, before.time + rate * dt)) for rate in rates]
    tried = [_placed(time, before.place, nominal, stance, gait, dcm, swing, elapsed) for time in times]
    return min(tried, key=lambda each: each[0])[1]


def descent_time(z: Axis, ground: float) -> float:
    """Return the shortest time to rest on the ground, s, at the largest acceleration a.

    From the height h with the upward speed v: (v + 2 √(v²/2 + a h)) / a.
    """
    a, v, h = FOOT_ACCELERATION, z.velocity, max(z.position - ground, 0.0)
    return (v + 2.0 * math.sqrt(0.5 * v * v + a * h)) / a


def _placed(
    time: float,
    before: complex,
    nominal: NominalStep,
    stance: Stance,
    gait: Gait,
    dcm: complex,
    swing: SwingFoot,
    elapsed: float,
) -> tuple[float, StepTarget]:
    """Return the cost and the target of the best step with the duration T of the single support."""
    left = time - elapsed
    push = gait.reaction / stance.omega * swing.growing(before, left, stance.omega)
    end = later(dcm, stance.place, stance.omega, left) + push  # ξ_T
    error = end - nominal.offset - nominal.place
    place = nominal.place + W_OFFSET / (W_PLACE + W_OFFSET) * error
    place = _within_reach(place, stance, gait)
    far = abs(place - swing.place)
    reachable = FOOT_SPEED * max(left, 0.0)
    if far > reachable:
        place = swing.place + (place - swing.place) * (reachable / far)
    offset = end - place
    late = math.exp(stance.omega * (time - gait.single)) - 1.0
    cost = (
        W_PLACE * abs(place - nominal.place) ** 2 + W_OFFSET * abs(offset - nominal.offset) ** 2 + W_TIME * late * late
    )
    return cost, StepTarget(place, offset, time)


def _within_reach(place: complex, stance: Stance, gait: Gait) -> complex:
    """Clip a place to the longest step and the smallest and largest width."""
    axes = cmath.rect(1.0, stance.heading)
    local = (place - stance.place) / axes
    x = max(-gait.length, min(gait.length, local.real))
    y = max(gait.least_width, min(gait.greatest_width, stance.side * local.imag))
    return stance.place + complex(x, stance.side * y) * axes
