"""Parts of compiled functions: placements and rotations.

A placement is (12,): the columns of its rotation, and the translation.
"""

from __future__ import annotations

import math

from wbc_controller.compiled import part
from wbc_controller.records import Array


@part
def turn(R: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """R (x, y, z) for the rotation of a placement."""
    return (
        R[0] * x + R[3] * y + R[6] * z,
        R[1] * x + R[4] * y + R[7] * z,
        R[2] * x + R[5] * y + R[8] * z,
    )


@part
def turn_back(R: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Rᵀ (x, y, z)."""
    return (
        R[0] * x + R[1] * y + R[2] * z,
        R[3] * x + R[4] * y + R[5] * z,
        R[6] * x + R[7] * y + R[8] * z,
    )


@part
def cross(a: float, b: float, c: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """(a, b, c) × (x, y, z)."""
    return b * z - c * y, c * x - a * z, a * y - b * x


@part
def place(frame: Array, mount: Array, out: Array) -> None:
    """The placement of something that is mounted on a frame."""
    for column in range(3):
        x, y, z = turn(frame, mount[3 * column], mount[3 * column + 1], mount[3 * column + 2])
        out[3 * column], out[3 * column + 1], out[3 * column + 2] = x, y, z
    x, y, z = turn(frame, mount[9], mount[10], mount[11])
    out[9], out[10], out[11] = frame[9] + x, frame[10] + y, frame[11] + z


@part
def quaternion(R: Array, out: Array) -> None:
    """The quaternion (x, y, z, w) of a placement's rotation, by its largest component (Shepperd)."""
    trace = R[0] + R[4] + R[8]
    if trace > 0.0:
        s = 2.0 * math.sqrt(1.0 + trace)
        out[0], out[1], out[2], out[3] = (R[5] - R[7]) / s, (R[6] - R[2]) / s, (R[1] - R[3]) / s, 0.25 * s
        return
    i = 0
    for k in range(1, 3):
        if R[4 * k] > R[4 * i]:
            i = k
    j, k = (i + 1) % 3, (i + 2) % 3
    s = 2.0 * math.sqrt(1.0 + R[4 * i] - R[4 * j] - R[4 * k])
    out[i] = 0.25 * s
    out[j] = (R[3 * i + j] + R[3 * j + i]) / s
    out[k] = (R[3 * i + k] + R[3 * k + i]) / s
    out[3] = (R[3 * j + k] - R[3 * k + j]) / s
