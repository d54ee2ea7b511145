"""Kernel for the reference of a swing foot."""

from __future__ import annotations

import math

import numpy as np

from wbc_controller.compilation import Matrix, OutVector, Vector, compiled, part
from wbc_controller.inverse_dynamics.robot.placement_kernels import (
    cross,
    dot,
    place,
    put,
    quaternion,
    scale,
    subtract,
    three,
)
from wbc_controller.records import Array


@part
def _put_rotation(out: Array, slope: complex, heading: float) -> None:
    """Write the columns of the rotation of a sole on a slope with a heading."""
    c, s = math.cos(heading), math.sin(heading)
    x, z = (c, s, slope.real * c + slope.imag * s), (-slope.real, -slope.imag, 1.0)
    x, z = scale(1.0 / math.sqrt(dot(x, x)), x), scale(1.0 / math.sqrt(dot(z, z)), z)
    put(out, 0, x)
    put(out, 3, cross(z, x))
    put(out, 6, z)


@compiled
def frame_in_swing(motion: Matrix, slope: complex, mount: Vector, out: OutVector) -> None:
    """Write the reference of a frame for a sole in the air: position, quaternion, velocity and acceleration, (19,).

    The sole is parallel to a slope and turns with its heading ψ about the vertical. With the offset r from its centre
    to the frame, ṗ = ċ + ψ̇ e_z × r and p̈ = c̈ + ψ̈ e_z × r + ψ̇² e_z × (e_z × r).

    Args:
        motion: position, velocity and acceleration of x, y, z and ψ, (3, 4) in m and rad.
        slope: dz/dx + i dz/dy.
        mount: placement of the frame in the sole, (12,).
    """
    if motion.shape != (3, 4) or len(mount) != 12 or len(out) != 19:
        raise ValueError("frame_in_swing: wrong sizes")
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
