"""Adaptation of place and time of a step.

At the end of the single support after the time T, the DCM is at

    ξ_T = p + (ξ - p) e^{ω (T - t)} + (μ/ω) ∫ e^{ω (T - s)} ẍ ds

with the acceleration ẍ of the swing foot (`reaction`). The new foot is placed at u, and b = ξ_T - u is the offset from
which the next step starts. The walker minimizes

    w_u |u - u*|² + w_b |b - b*|² + w_T (e^{ω (T - T*)} - 1)²

with the nominal u*, b* and T*, and u within the reach of the leg. For a given T, u follows in closed form. The cost is
convex in e^{ωT}, so one step of T towards lower cost per cycle finds the minimum.

Source: Khadiv et al., IEEE Transactions on Robotics 36, 2020.
"""

from __future__ import annotations

import cmath
import math

import numpy as np

from wbc_controller.compilation import Matrix, compiled, part
from wbc_controller.walking.footsteps_kernels import StepSizes, periodic_step
from wbc_controller.walking.pendulum_kernels import before, later
from wbc_controller.walking.swing_kernels import integrate_foot

W_PLACE, W_OFFSET, W_TIME = 1.0, 200.0, 0.02  # weights of place and offset, 1/m², and of time
#: Shortest and longest single support, as shares of the nominal one; a faster foot would hit the edges of rough ground.
SHORTEST, SHORTEST_ROUGH, LONGEST = 0.4, 0.65, 1.6
TIME_RATE, SHORTENING = 1.0, 10.0  # usual rate of the step time, and decrease for a DCM beside the sole
_HELD = 0.35  # distance of a DCM above the sole from its centre, as shares of length and width
_AHEAD = 0.04  # shortest remaining time of an adaptation, s
FOOT_SPEED, FOOT_ACCELERATION = 3.0, 20.0  # largest mean speed of the swing foot, m/s, and vertical acceleration, m/s²
#: Largest horizontal deceleration of the swing foot, m/s²: a faster stop lifts the body.
FOOT_BRAKING = 80.0
#: Distance between passing soles, m, and longest duration of such a step, as a share of the nominal one.
_APART, _PASSING = 0.01, 0.6


@compiled
def descent_time(height: float, speed: float) -> float:
    """Return the shortest time to rest on the ground, s, at the largest acceleration a.

    From the height h with the upward speed v: (v + 2 √(v²/2 + a h)) / a.
    """
    h = max(height, 0.0)
    return (speed + 2.0 * math.sqrt(0.5 * speed * speed + FOOT_ACCELERATION * h)) / FOOT_ACCELERATION


@compiled
def stopping_time(speed: float) -> float:
    """Return the shortest time to rest, s: within T, a quintic brakes from a speed v at up to 1.5 v / T."""
    return 1.5 * speed / FOOT_BRAKING


@part
def _least_width(x: float, foot_x: float, foot_y: float, sizes: StepSizes) -> float:
    """Return the least distance sideways between the feet for a foot that moves to x ahead of the stance foot, m.

    More than one sole ahead or behind, the feet may be on one line, if the straight way of the foot, now foot_x ahead
    and foot_y aside, passes the corner of the stance foot.
    """
    length, width = sizes.sole_length + _APART, sizes.sole_width + _APART
    beyond, way = abs(x) - length, length - math.copysign(foot_x, x * foot_x)  # way along x to the corner
    if beyond <= 0.0:
        return sizes.least_width
    slope = max(foot_y - width, 0.0) / way if way > 0.0 else math.inf
    return max(0.0, min(sizes.least_width, width - slope * beyond))


@part
def _within_reach(
    place: complex, foot: complex, time: float, stance: complex, axes: complex, side: int, sizes: StepSizes,
    planned: bool,
) -> complex:  # fmt: skip
    local, present, least = (place - stance) / axes, (foot - stance) / axes, sizes.least_width
    x = max(-sizes.length, min(sizes.length, local.real))
    if time < _PASSING * sizes.single:
        least = _least_width(x, present.real, side * present.imag, sizes)
    y = max(least, min(sizes.greatest_width, side * local.imag))
    aside = y - sizes.width
    if aside > 0.0 and not planned:  # the leg does not reach far ahead and aside at once
        far = math.hypot(x / sizes.length, aside / (sizes.greatest_width - sizes.width))
        if far > 1.0:
            x, y = x / far, sizes.width + aside / far
    return stance + complex(x, side * y) * axes


@part
def _height_at(place: complex, ground: complex, level: float, slope: complex) -> float:
    to = place - ground
    return level + slope.real * to.real + slope.imag * to.imag


@compiled
def dcm_towards(
    place: complex, offset: complex, stance: complex, omega: float, reaction: float, swing: Matrix, left: float
) -> complex:
    """Return the DCM that leads to an offset from a touchdown at a place after the time `left`, s."""
    return before(place + offset, stance, omega, left, reaction / omega * integrate_foot(swing, place, left, omega))


@compiled
def adapt(
    planned: bool, nominal_place: complex, nominal_heading: float, nominal_offset: complex, velocity: complex,
    turning: float, place: complex, time: float, stance: complex, heading: float, side: int, omega: float,
    sizes: StepSizes, dcm: complex, swing: Matrix, ground: complex, level: float, slope: complex, elapsed: float,
    dt: float, shortest: float,
) -> tuple[complex, float, complex, complex, float, float, float, complex]:  # fmt: skip
    """Return the nominal step, the touchdown for the measured DCM, and the DCM that leads to them.

    The touchdown has a place, a height, a heading less than half a turn away from that of the foot, and a time.

    Args:
        planned: keep the nominal step, u*, heading and b*, of the last cycle; otherwise it follows the velocity.
        velocity, turning: command, m/s and rad/s.
        place, time: u and T of the last cycle, x + i y in m in the world, and s.
        stance, heading, side, omega: fields of `Stance`; `sizes.single` is T*.
        dcm, swing: measured ξ, and motion of the swing foot, (3, 4).
        ground, level, slope: place and height of a point of the ground, m, and slope dz/dx + i dz/dy.
        elapsed, dt: t since the start of the single support, and time since the last cycle, s.
        shortest: duration of the fastest step, s.
    """
    if not planned:
        nominal_place, nominal_heading, nominal_offset = periodic_step(
            velocity, turning, time, stance, heading, side, omega, sizes
        )
    single, reaction = sizes.single, sizes.reaction
    braking = stopping_time(math.hypot(swing[1, 0], swing[1, 1]))
    above = swing[0, 2] - _height_at(place, ground, level, slope)
    earliest = max(shortest, elapsed + max(_AHEAD, braking, descent_time(above, swing[1, 2])))
    latest = max(LONGEST * single, earliest)
    axes, lowest, best = cmath.rect(1.0, heading), math.inf, (place, time)
    local = (dcm - stance) / axes
    # The centre of pressure can hold it; a fast leg would push it away.
    held = abs(local.real) < _HELD * sizes.sole_length and abs(local.imag) < _HELD * sizes.sole_width
    for rate in (0.0, -TIME_RATE, TIME_RATE, -TIME_RATE if held else -SHORTENING):
        T = max(earliest, min(latest, time + rate * dt))
        left = T - elapsed
        push = reaction / omega * integrate_foot(swing, place, left, omega)
        end = later(dcm, stance, omega, left) + push  # ξ_T
        u = nominal_place + W_OFFSET / (W_PLACE + W_OFFSET) * (end - nominal_offset - nominal_place)
        foot = complex(swing[0, 0], swing[0, 1])
        u = _within_reach(u, foot, T, stance, axes, side, sizes, planned)
        far, reachable = abs(u - foot), FOOT_SPEED * max(left, 0.0)
        if far > reachable:
            u = foot + (u - foot) * (reachable / far)
        late = math.exp(omega * (T - single)) - 1.0
        place_error, offset_error = abs(u - nominal_place), abs(end - u - nominal_offset)
        cost = W_PLACE * place_error**2 + W_OFFSET * offset_error**2 + W_TIME * late * late
        if cost < lowest:
            lowest, best = cost, (u, T)
    place, time = best
    wanted = dcm_towards(nominal_place, nominal_offset, stance, omega, reaction, swing, max(time - elapsed, 0.0))
    turn = nominal_heading - swing[0, 3]
    facing = swing[0, 3] + (turn - 2.0 * math.pi * np.round(turn / (2.0 * math.pi)))
    height = _height_at(place, ground, level, slope)
    return nominal_place, nominal_heading, nominal_offset, place, height, facing, time, wanted


@compiled
def steps_again(
    dcm: complex, stance: complex, heading: float, landed: complex, landed_heading: float, side: int, omega: float,
    sizes: StepSizes, shortest: float,
) -> bool:  # fmt: skip
    """Return whether a foot that has `landed` steps again: the DCM is beyond its outer side, but within its reach.

    The other foot cannot land there. Other arguments as of `adapt`.
    """
    half = 0.5 * sizes.sole_width
    outside = side * ((dcm - landed) * cmath.rect(1.0, -landed_heading)).imag
    aside = side * ((dcm - stance) * cmath.rect(1.0, -heading)).imag * math.exp(omega * shortest)
    return outside > half and aside < sizes.greatest_width + half
