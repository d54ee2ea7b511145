"""Vectors, placements and motions.

A vector is a tuple of three numbers; a placement an array (12,) of the columns of the rotation R and the translation p;
a motion [linear, angular] a pair of vectors or an array (6,).
"""

import math
from typing import TypeAlias

from wbc_controller.compilation import part
from wbc_controller.records import Array

Vector3: TypeAlias = tuple[float, float, float]
Motion: TypeAlias = tuple[Vector3, Vector3]


@part
def three(array: Array, start: int) -> Vector3:
    """Return three numbers of an array."""
    return array[start], array[start + 1], array[start + 2]


@part
def put(out: Array, start: int, a: Vector3) -> None:
    """Write a vector."""
    out[start], out[start + 1], out[start + 2] = a


@part
def put_motion(out: Array, motion: Motion) -> None:
    """Write a motion, (6,)."""
    put(out, 0, motion[0])
    put(out, 3, motion[1])


@part
def add(a: Vector3, b: Vector3) -> Vector3:
    """Return a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@part
def subtract(a: Vector3, b: Vector3) -> Vector3:
    """Return a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@part
def scale(factor: float, a: Vector3) -> Vector3:
    """Return a vector times a factor."""
    return factor * a[0], factor * a[1], factor * a[2]


@part
def dot(a: Vector3, b: Vector3) -> float:
    """Return aᵀ b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@part
def cross(a: Vector3, b: Vector3) -> Vector3:
    """Return a × b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@part
def rotate(frame: Array, a: Vector3) -> Vector3:
    """Return R a."""
    return (
        frame[0] * a[0] + frame[3] * a[1] + frame[6] * a[2],
        frame[1] * a[0] + frame[4] * a[1] + frame[7] * a[2],
        frame[2] * a[0] + frame[5] * a[1] + frame[8] * a[2],
    )


@part
def rotate_back(frame: Array, a: Vector3) -> Vector3:
    """Return Rᵀ a."""
    return (
        frame[0] * a[0] + frame[1] * a[1] + frame[2] * a[2],
        frame[3] * a[0] + frame[4] * a[1] + frame[5] * a[2],
        frame[6] * a[0] + frame[7] * a[1] + frame[8] * a[2],
    )


@part
def transform(frame: Array, a: Vector3) -> Vector3:
    """Return the point p + R a."""
    return add(three(frame, 9), rotate(frame, a))


@part
def place(frame: Array, mount: Array, out: Array) -> None:
    """Write the placement of a mount on a frame."""
    for column in range(0, 9, 3):
        put(out, column, rotate(frame, three(mount, column)))
    put(out, 9, transform(frame, three(mount, 9)))


@part
def to_world(frame: Array, linear: Vector3, angular: Vector3) -> Motion:
    """Transform a motion from a frame's axes and origin to the world's."""
    angular = rotate(frame, angular)
    return add(rotate(frame, linear), cross(three(frame, 9), angular)), angular


@part
def to_frame(frame: Array, linear: Vector3, angular: Vector3) -> Motion:
    """Transform a motion from the world's axes and origin to a frame's."""
    return rotate_back(frame, add(linear, cross(angular, three(frame, 9)))), rotate_back(frame, angular)


@part
def quaternion(frame: Array, out: Array) -> None:
    """Write the quaternion (x, y, z, w) of a placement's rotation (Shepperd)."""
    trace = frame[0] + frame[4] + frame[8]
    if trace > 0.0:
        s = 2.0 * math.sqrt(1.0 + trace)
        put(out, 0, ((frame[5] - frame[7]) / s, (frame[6] - frame[2]) / s, (frame[1] - frame[3]) / s))
        out[3] = 0.25 * s
        return
    i = 0
    for k in range(1, 3):
        if frame[4 * k] > frame[4 * i]:
            i = k
    j, k = (i + 1) % 3, (i + 2) % 3
    s = 2.0 * math.sqrt(1.0 + frame[4 * i] - frame[4 * j] - frame[4 * k])
    out[i] = 0.25 * s
    out[j] = (frame[3 * i + j] + frame[3 * j + i]) / s
    out[k] = (frame[3 * i + k] + frame[3 * k + i]) / s
    out[3] = (frame[3 * j + k] - frame[3 * k + j]) / s
