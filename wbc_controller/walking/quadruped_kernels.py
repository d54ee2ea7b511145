"""Kernels for the plane of the ground under point feet, and for their placement in a trot.

Two point feet exert no moment about the line between them. Along the line the controller accelerates the body; across
it the body falls like the linear inverted pendulum, ξ̇ = ω (ξ - p). The place of the next line controls it.
"""

from __future__ import annotations

import math

from wbc_controller.compilation import Matrix, Vector, compiled
from wbc_controller.walking.pendulum_kernels import periodic_offset


@compiled
def plane_below(points: Matrix) -> tuple[complex, float, complex]:
    """Return the mean place and height of points, (n, 3), and the slope of the plane of `Ground.below`.

    With x, y and z relative to their means, the slope s solves Σ (x, y)ᵀ(x, y) s = Σ (x, y)ᵀ z.
    """
    n = len(points)
    if points.shape[1] != 3 or n < 3:
        raise ValueError("plane_below: wrong size")
    x0 = y0 = z0 = xx = xy = yy = xz = yz = 0.0
    for i in range(n):
        x0, y0, z0 = x0 + points[i, 0] / n, y0 + points[i, 1] / n, z0 + points[i, 2] / n
    for i in range(n):
        x, y, z = points[i, 0] - x0, points[i, 1] - y0, points[i, 2] - z0
        xx, xy, yy, xz, yz = xx + x * x, xy + x * y, yy + y * y, xz + x * z, yz + y * z
    return complex(x0, y0), z0, complex(xz * yy - yz * xy, yz * xx - xz * xy) / (xx * yy - xy * xy)


@compiled
def motion_of_body(
    com: Vector, velocity: Vector, centroidal: Matrix, v: Vector, mass: float, height: float, gravity: float
) -> tuple[complex, complex, float]:
    """Return c, ξ = c + (ċ + (L_y, -L_x) / (m z)) / ω, and ω, with the angular momentum L of the swinging legs.

    The arguments are c and ċ, (3,), A_Gᵀ, (nv, 6), v, m, the height z, and g.
    """
    if len(com) != 3 or len(velocity) != 3 or centroidal.shape != (len(v), 6):
        raise ValueError("motion_of_body: wrong sizes")
    Lx = Ly = 0.0
    for i in range(len(v)):
        Lx, Ly = Lx + centroidal[i, 3] * v[i], Ly + centroidal[i, 4] * v[i]
    place, omega = complex(com[0], com[1]), math.sqrt(gravity / height)
    return place, place + (complex(velocity[0], velocity[1]) + complex(Ly, -Lx) / (mass * height)) / omega, omega


@compiled
def later_on_line(dcm: complex, a: complex, b: complex, velocity: complex, omega: float, time: float) -> complex:
    """Return the DCM after a time t in s on the line through a and b with the unit vector t.

    It is ξ + (v·t) t t along the line, and p + (ξ - p) e^{ωt} across it. The controller keeps the component of the
    commanded velocity v, in m/s, along the line.
    """
    along = (b - a) / abs(b - a)
    distance = ((dcm - a) * (1j * along).conjugate()).real
    forward = (velocity * along.conjugate()).real
    return dcm + forward * time * along + distance * (math.exp(omega * time) - 1.0) * 1j * along


@compiled
def middle_of_pair(dcm: complex, velocity: complex, omega: float, duration: float) -> complex:
    """Return the middle between the new feet for a DCM ξ at their touchdown: ξ - v T / (e^{ωT} - 1).

    This is the offset of the gait that repeats the progress v T, without width (`periodic_offset`): v is the commanded
    velocity in the world during the stance, m/s, T the duration from this touchdown to the next, s.
    """
    return dcm - periodic_offset(velocity * duration, 0j, omega, duration, 0.0, 0.0)


@compiled
def next_pair(
    dcm: complex, places: Matrix, a: int, b: int, velocity: complex, following: complex, omega: float, left: float,
    stance: float,
) -> tuple[complex, complex]:  # fmt: skip
    """Return the body at touchdown, ξ - v / ω, and the middle of the new pair.

    Args:
        places, a, b: places of all feet, (n, 3) in m, and rows of those on the ground.
        velocity, following: commanded velocities in the world at touchdown, and in the middle of the next stance, m/s.
        left, stance: time until touchdown, and duration of the next stance, s.
    """
    first, second = complex(places[a, 0], places[a, 1]), complex(places[b, 0], places[b, 1])
    dcm = later_on_line(dcm, first, second, velocity, omega, left)
    return dcm - velocity / omega, middle_of_pair(dcm, following, omega, stance)
