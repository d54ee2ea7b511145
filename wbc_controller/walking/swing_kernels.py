"""Motion of a swing foot: one quintic per coordinate, replanned in every cycle.

The motion of a foot is an array (3, 4): rows position, velocity and acceleration, columns x, y, z in m and heading in
rad. A coordinate x with the rates v and a moves after the time t to x + v t + a t²/2 + c₃ t³ + c₄ t⁴ + c₅ t⁵.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wbc_controller.compilation import Matrix, OutMatrix, compiled, part
from wbc_controller.inverse_dynamics.robot.placement_kernels import Vector3
from wbc_controller.records import Array

APEX = 0.45  # share of the step at which the foot is highest
TOUCHDOWN_SPEED = 0.1  # downward speed at touchdown on even ground, m/s
_LATE_ACCELERATION, LATE_SPEED = 10.0, 0.5  # downward acceleration and speed of a late foot, m/s² and m/s
#: Time before the apex at which the plan changes from the apex to the ground, s: later, small changes need large
#: accelerations.
DESCENT = 0.06
_SHORTEST = 0.0005  # shortest remaining time of a new plan, s
#: Shares of the step on rough ground in which the foot only rises and only descends, beside the edges of stones, and
#: shortest remaining time of a plan for the end of the horizontal motion, s.
_RISING, _DESCENDING, _ENDING = 0.2, 0.15, 0.05


@dataclass(slots=True)  # not frozen: faster construction
class Landing:
    """Planned touchdown of the swing foot."""

    place: complex  # u, x + i y in m in the world
    height: float  # there, m; below rough ground
    heading: float  # of the foot, rad; less than half a turn away from the present one; 0 for a point foot
    time: float  # T, after lift-off, s
    speed: float = TOUCHDOWN_SPEED  # downwards, m/s
    roughness: float = 0.0  # of the ground, from 0 (even) to 1


def at_rest(place: complex, height: float, heading: float) -> Array:
    """Return the motion, (3, 4), of a foot at rest at a place, x + i y in m, a height, m, and a heading, rad."""
    return np.array([[place.real, place.imag, height, heading], [0.0] * 4, [0.0] * 4])


@part
def _quintic(x: float, v: float, a: float, goal: float, speed: float, T: float) -> Vector3:
    """Return c₃, c₄ and c₅ of the way to a goal after the time T, reached at a speed without acceleration."""
    d = goal - x - v * T - 0.5 * a * T * T
    e = (speed - v - a * T) * T
    f = -a * T * T
    return (
        (10.0 * d - 4.0 * e + 0.5 * f) / T**3,
        (-15.0 * d + 7.0 * e - f) / T**4,
        (6.0 * d - 3.0 * e + 0.5 * f) / T**5,
    )


@compiled
def move_axis(x: float, v: float, a: float, goal: float, speed: float, left: float, dt: float) -> Vector3:
    """Return a coordinate with its rates after `dt` on the way to a goal, reached at a speed in the time `left`, s."""
    if left <= _SHORTEST:
        return x, 0.0, 0.0
    t = min(dt, left)
    c3, c4, c5 = _quintic(x, v, a, goal, speed, left)
    return (
        x + t * (v + t * (0.5 * a + t * (c3 + t * (c4 + t * c5)))),
        v + t * (a + t * (3.0 * c3 + t * (4.0 * c4 + t * 5.0 * c5))),
        a + t * (6.0 * c3 + t * (12.0 * c4 + t * 20.0 * c5)),
    )


@compiled
def move_foot(
    foot: Matrix, place: complex, height: float, heading: float, duration: float, speed: float, roughness: float,
    clearance: float, elapsed: float, dt: float, descent: float, out: OutMatrix,
) -> None:  # fmt: skip
    """Write the motion after one cycle to a touchdown; arguments of `moved`.

    On rough ground the foot rises before it moves horizontally, and ends the horizontal motion before the touchdown.
    `integrate_foot` and the adaptation neglect this.
    """
    if foot.shape != (3, 4) or out.shape != (3, 4):
        raise ValueError("move_foot: wrong sizes")
    left, top = duration - elapsed, APEX * duration
    ending = min(left, max(left - _DESCENDING * roughness * duration, _ENDING))
    goals = (place.real, place.imag, height, heading)
    for i in range(4):
        x, v, a = foot[0, i], foot[1, i], foot[2, i]
        if i != 2 and elapsed < _RISING * roughness * duration:
            moved = (x, 0.0, 0.0)
        elif i != 2:
            moved = move_axis(x, v, a, goals[i], 0.0, ending, dt)
        elif top - elapsed > descent:
            moved = move_axis(x, v, a, height + clearance, 0.0, top - elapsed, dt)
        elif left > _SHORTEST:
            moved = move_axis(x, v, a, height, -speed, left, dt)
        else:
            v = max(min(v, -speed) - _LATE_ACCELERATION * dt, -LATE_SPEED)
            moved = (x + v * dt, v, -_LATE_ACCELERATION if v > -LATE_SPEED else 0.0)
        out[0, i], out[1, i], out[2, i] = moved


def moved(
    foot: Array, landing: Landing, clearance: float, elapsed: float, dt: float, descent: float = DESCENT
) -> Array:
    """Return the motion of a foot, (3, 4), after one cycle; a late foot accelerates downwards. All times in s.

    `clearance` is its height above the ground at the apex, m, `elapsed` the time since lift-off, and `descent` the time
    before the apex at which the plan changes to the ground.
    """
    out = np.empty((3, 4))
    move_foot(
        foot, landing.place, landing.height, landing.heading, landing.time, landing.speed, landing.roughness,
        clearance, elapsed, dt, descent, out,
    )  # fmt: skip
    return out


@compiled
def integrate_axis(x: float, v: float, a: float, goal: float, left: float, omega: float) -> float:
    """Return ∫ e^{ω(T - t)} ẍ(t) dt in m/s over the quintic to rest at a goal, in the remaining time T.

    With I_k = ∫ e^{ω(T - t)} tᵏ dt: I_0 = (e^{ωT} - 1) / ω and I_k = (k I_{k-1} - Tᵏ) / ω.
    """
    if left <= _SHORTEST:
        return 0.0
    c3, c4, c5 = _quintic(x, v, a, goal, 0.0, left)
    i0 = (math.exp(omega * left) - 1.0) / omega
    i1 = (i0 - left) / omega
    i2 = (2.0 * i1 - left**2) / omega
    i3 = (3.0 * i2 - left**3) / omega
    return a * i0 + 6.0 * c3 * i1 + 12.0 * c4 * i2 + 20.0 * c5 * i3


@compiled
def integrate_foot(foot: Matrix, place: complex, left: float, omega: float) -> complex:
    """Return the integral of `integrate_axis` for the horizontal motion of a foot to a place, x + i y in m/s."""
    if foot.shape != (3, 4):
        raise ValueError("integrate_foot: wrong size")
    x = integrate_axis(foot[0, 0], foot[1, 0], foot[2, 0], place.real, left, omega)
    return complex(x, integrate_axis(foot[0, 1], foot[1, 1], foot[2, 1], place.imag, left, omega))
