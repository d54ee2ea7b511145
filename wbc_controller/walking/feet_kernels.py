"""Kernels for the motion of feet, and for the reference of a swing foot."""

from __future__ import annotations

import math

import numpy as np

from wbc_controller.compilation import Indices, Matrix, OutMatrix, OutVector, Vector, compiled, copy_rows, part
from wbc_controller.inverse_dynamics.robot.placement_kernels import (
    Vector3,
    add,
    cross,
    dot,
    place,
    put,
    quaternion,
    scale,
    subtract,
    three,
    transform,
)
from wbc_controller.records import Array
from wbc_controller.walking.swing_kernels import move_foot

_LEVELLING = 0.05  # time constant of the swing foot's rotation to the slope of the ground, s


@part
def _velocity(link: Array, point: Vector3) -> Vector3:
    return add(three(link, 0), cross(three(link, 3), point))


@compiled
def motion_of_points(joints: Matrix, links: Matrix, on: Indices, offsets: Matrix, out: OutMatrix) -> None:
    """Write position and velocity of points with offsets on links, (n, 3), in world axes, (n, 6).

    `on` contains the index of the link of each point; `joints` and `links` are those of `Dynamics`.
    """
    if len(joints) != len(links) or offsets.shape != (len(on), 3) or out.shape != (len(on), 6) or max(on) >= len(links):
        raise ValueError("motion_of_points: wrong sizes")
    for i in range(len(on)):
        point = transform(joints[on[i]], three(offsets[i], 0))
        put(out[i], 0, point)
        put(out[i], 3, _velocity(links[on[i]], point))


@compiled
def motion_of_sole(
    joints: Matrix, links: Matrix, link: int, mount: Vector
) -> tuple[complex, float, float, complex, float, float, float]:
    """Return the fields of `feet.Sole` for the placement of a sole on a link, (12,); other arguments as above."""
    if len(joints) != len(links) or not 0 <= link < len(links) or len(mount) != 12:
        raise ValueError("motion_of_sole: wrong sizes")
    sole = np.empty(12)
    place(joints[link], mount, sole)
    x, y, z = three(sole, 9)
    v = _velocity(links[link], (x, y, z))
    slope = complex(-sole[6] / sole[8], -sole[7] / sole[8])
    turning = math.hypot(links[link, 3], links[link, 4])
    return complex(x, y), z, math.atan2(sole[1], sole[0]), slope, v[2], math.sqrt(dot(v, v)), turning


@part
def _put_rotation(out: Array, slope: complex, heading: float) -> None:
    c, s = math.cos(heading), math.sin(heading)
    x, z = (c, s, slope.real * c + slope.imag * s), (-slope.real, -slope.imag, 1.0)
    x, z = scale(1.0 / math.sqrt(dot(x, x)), x), scale(1.0 / math.sqrt(dot(z, z)), z)
    put(out, 0, x)
    put(out, 3, cross(z, x))
    put(out, 6, z)


@part
def _put_frame(out: Array, motion: Array, slope: complex, mount: Array) -> None:
    """Write the reference of a frame for a sole in the air: position, quaternion, velocity and acceleration, (19,).

    The sole is parallel to a slope dz/dx + i dz/dy and turns with its heading ψ about the vertical. With the offset r
    from its centre to the frame, ṗ = ċ + ψ̇ e_z × r and p̈ = c̈ + ψ̈ e_z × r + ψ̇² e_z × (e_z × r). `motion` contains x,
    y, z and ψ with their rates, (3, 4) in m and rad, `mount` the placement of the frame in the sole, (12,).
    """
    sole, frame = np.empty(12), np.empty(12)
    _put_rotation(sole, slope, motion[0, 3])
    put(sole, 9, (motion[0, 0], motion[0, 1], motion[0, 2]))
    place(sole, mount, frame)
    put(out, 0, three(frame, 9))
    quaternion(frame, out[3:7])
    (x, y, _), v, a = subtract(three(frame, 9), three(sole, 9)), motion[1], motion[2]
    put(out, 7, (v[0] - v[3] * y, v[1] + v[3] * x, v[2]))
    put(out, 10, (0.0, 0.0, v[3]))
    put(out, 13, (a[0] - a[3] * y - v[3] * v[3] * x, a[1] + a[3] * x - v[3] * v[3] * y, a[2]))
    put(out, 16, (0.0, 0.0, a[3]))


@compiled
def move_sole(
    sole: Matrix, place: complex, height: float, heading: float, duration: float, speed: float, roughness: float,
    clearance: float, elapsed: float, dt: float, descent: float, lag: float, slope: complex, ground: complex,
    mount: Vector, motion: OutMatrix, out: OutVector,
) -> tuple[complex, complex]:  # fmt: skip
    """Write the motion of a sole after one cycle, and the reference of its frame; see `Foot.swung`."""
    if sole.shape != (3, 4) or motion.shape != (3, 4) or len(mount) != 12 or len(out) != 19:
        raise ValueError("move_sole: wrong sizes")
    if dt > 0.0:
        move_foot(sole, place, height, heading, duration, speed, roughness, clearance, elapsed, dt, descent, motion)
        slope += (ground - slope) * min(1.0, dt / _LEVELLING)
    else:
        copy_rows(sole, motion)
    ahead = np.empty((3, 4))
    move_foot(motion, place, height, heading, duration, speed, roughness, clearance, elapsed + dt, lag, descent, ahead)
    copy_rows(motion[:2], ahead)
    _put_frame(out, ahead, slope, mount)
    return complex(ahead[2, 0], ahead[2, 1]), slope
