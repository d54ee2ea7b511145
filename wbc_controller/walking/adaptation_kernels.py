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

from __future__ import annotations

import cmath
import math

from wbc_controller.compilation import Matrix, compiled, part
from wbc_controller.walking.swing_kernels import integrate_foot

#: Weights of place and offset, 1/m², and of time.
W_PLACE, W_OFFSET, W_TIME = 1.0, 200.0, 0.02
#: Shortest and longest single support, as shares of the nominal one.
SHORTEST, LONGEST = 0.5, 1.6
#: Rate of change of the step time, and the one of a large decrease.
TIME_RATE, SHORTENING = 1.0, 10.0
#: Shortest remaining time of an adaptation, s.
_AHEAD = 0.04
#: Largest mean speed of the swing foot, m/s, and vertical acceleration, m/s².
FOOT_SPEED, FOOT_ACCELERATION = 2.5, 20.0


@compiled
def descent_time(height: float, speed: float) -> float:
    """Return the shortest time to rest on the ground, s, at the largest acceleration a.

    From the height h with the upward speed v: (v + 2 √(v²/2 + a h)) / a.
    """
    h = max(height, 0.0)
    return (speed + 2.0 * math.sqrt(0.5 * speed * speed + FOOT_ACCELERATION * h)) / FOOT_ACCELERATION


@part
def _within_reach(
    place: complex, stance: complex, axes: complex, side: int, length: float, least_width: float, greatest_width: float
) -> complex:
    """Clip a place to the longest step and the smallest and largest width."""
    local = (place - stance) / axes
    x = max(-length, min(length, local.real))
    y = max(least_width, min(greatest_width, side * local.imag))
    return stance + complex(x, side * y) * axes


@compiled
def adapt(
    place: complex, time: float, nominal_place: complex, nominal_offset: complex, nominal_time: float,
    stance: complex, heading: float, side: int, length: float, least_width: float, greatest_width: float,
    dcm: complex, omega: float, reaction: float, swing: Matrix, ground: float, elapsed: float, dt: float,
) -> tuple[complex, float]:  # fmt: skip
    """Return place and time of the touchdown for the measured DCM.

    Args:
        place: u of the last cycle, x + i y in m in the world.
        time: T of the last cycle, s.
        nominal_place, nominal_offset, nominal_time: u*, b* and T*.
        stance, heading: place p and heading of the stance foot.
        side: 1 if the swing foot is the left one, -1 for the right one.
        length, least_width, greatest_width: reach of the leg, m.
        dcm: ξ, measured.
        omega: ω, 1/s.
        reaction: μ.
        swing: motion of the swing foot, (3, 4).
        ground: height of the ground, m.
        elapsed: t, since the start of the single support, s.
        dt: time since the last cycle, s.
    """
    earliest = max(SHORTEST * nominal_time, elapsed + max(_AHEAD, descent_time(swing[0, 2] - ground, swing[1, 2])))
    latest = max(LONGEST * nominal_time, earliest)
    axes, lowest, best = cmath.rect(1.0, heading), math.inf, (place, time)
    for rate in (0.0, -TIME_RATE, TIME_RATE, -SHORTENING):
        T = max(earliest, min(latest, time + rate * dt))
        left = T - elapsed
        push = reaction / omega * integrate_foot(swing, place, left, omega)
        end = stance + (dcm - stance) * math.exp(omega * left) + push  # ξ_T
        u = nominal_place + W_OFFSET / (W_PLACE + W_OFFSET) * (end - nominal_offset - nominal_place)
        u = _within_reach(u, stance, axes, side, length, least_width, greatest_width)
        present = complex(swing[0, 0], swing[0, 1])
        far, reachable = abs(u - present), FOOT_SPEED * max(left, 0.0)
        if far > reachable:
            u = present + (u - present) * (reachable / far)
        late = math.exp(omega * (T - nominal_time)) - 1.0
        place_error, offset_error = abs(u - nominal_place), abs(end - u - nominal_offset)
        cost = W_PLACE * place_error**2 + W_OFFSET * offset_error**2 + W_TIME * late * late
        if cost < lowest:
            lowest, best = cost, (u, T)
    return best
