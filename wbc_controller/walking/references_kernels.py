"""Kernels for the references of the body, the area of the centre of pressure, and the smooth step."""

from __future__ import annotations

import cmath
import math

from wbc_controller.compilation import Matrix, OutVector, compiled, part
from wbc_controller.inverse_dynamics.robot.placement_kernels import put, three

_HEIGHT_RATE, _FASTEST_HEIGHT = 3.0, 0.2  # rate at which a height follows its goal, 1/s, and its largest rate, m/s


@compiled
def smooth_step(share: float) -> tuple[float, float]:
    """Return the quintic from 0 to 1 at a share of its duration, and its derivative."""
    s = max(0.0, min(1.0, share))
    return s**3 * (10.0 - 15.0 * s + 6.0 * s * s), 30.0 * s * s * (1.0 - s) ** 2


@part
def clipped(point: complex, length: float, width: float) -> complex:
    """Return the nearest point of a rectangle about the origin with these half sides, m."""
    return complex(max(-length, min(length, point.real)), max(-width, min(width, point.imag)))


@compiled
def nearest_in_support(
    point: complex, first: complex, second: complex, heading: float, length: float, width: float
) -> complex:
    """Return the nearest point of the rectangle around the nearest point of the line between two feet.

    Points are x + i y in m; on one foot, `first` and `second` are the same. `length` and `width` are the half sides of
    the rectangle, m.
    """
    line, axes = second - first, cmath.rect(1.0, heading)
    squared = abs(line) ** 2
    share = ((point - first) * line.conjugate()).real / squared if squared > 0.0 else 0.0
    centre = first + max(0.0, min(1.0, share)) * line
    local = (point - centre) / axes
    return centre + clipped(local, length, width) * axes


@compiled
def body_references(
    place: complex, velocity: complex, acceleration: complex, height: float, goal: float, turn: float, turning: float,
    dt: float, orientations: Matrix, out: OutVector,
) -> float:  # fmt: skip
    """Write the references of the body, (12 + 4 n,); return its height after one cycle, m.

    They are position, velocity and acceleration of the centre of mass, angular velocity, and n quaternions.

    Args:
        place, velocity, acceleration: horizontal, x + i y in m, m/s and m/s².
        height, goal: height of the last cycle, and the one to follow, m.
        turn, turning: angle by which the orientations, (n, 4), are turned about the vertical, rad, and its rate, rad/s.
        dt: time since the last cycle, s.
    """
    if orientations.shape[1] != 4 or len(out) != 12 + 4 * len(orientations):
        raise ValueError("body_references: wrong sizes")
    rise = max(-_FASTEST_HEIGHT, min(_FASTEST_HEIGHT, _HEIGHT_RATE * (goal - height)))
    height += rise * dt
    put(out, 0, (place.real, place.imag, height))
    put(out, 3, (velocity.real, velocity.imag, rise))
    put(out, 6, (acceleration.real, acceleration.imag, 0.0))
    put(out, 9, (0.0, 0.0, turning))
    c, s = math.cos(0.5 * turn), math.sin(0.5 * turn)
    for i in range(len(orientations)):
        (x, y, z), w = three(orientations[i], 0), orientations[i, 3]
        put(out, 12 + 4 * i, (c * x - s * y, c * y + s * x, c * z + s * w))
        out[15 + 4 * i] = c * w - s * z
    return height
