"""Rotation matrices, quaternions (x, y, z, w), and transforms between worlds with a common vertical.

``pin.Quaternion(matrix)`` leaks 80 bytes per call with eigenpy 3.13, 140 MB per hour at 500 Hz.
"""

import math

import numpy as np
import pinocchio as pin

from wbc_controller.records import Array

_ORIGIN = np.zeros(3)


def quaternion_of(rotation: Array) -> Array:
    """Return the unit quaternion (x, y, z, w) of a rotation matrix (3, 3)."""
    return np.asarray(pin.SE3ToXYZQUAT(pin.SE3(rotation, _ORIGIN))[3:])


def rotation_of(quaternion: Array) -> Array:
    """Return the rotation matrix (3, 3) of a quaternion (x, y, z, w) of any length."""
    return np.asarray(pin.Quaternion(quaternion).normalized().toRotationMatrix())


def about_z(angle: float) -> Array:
    """Return the rotation about z by an angle in rad, (3, 3)."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def planar_transform(heading: float, x: Array, to: Array) -> pin.SE3:
    """Return the transform with a heading, rad, that maps a point x to `to`, (3,) in m.

    Worlds without absolute poses differ by such a transform, as heading and position are unobservable.
    """
    R = about_z(heading)
    return pin.SE3(R, to - R @ x)


def heading_of(transform: pin.SE3) -> float:
    """Return the rotation about z, rad."""
    return math.atan2(transform.rotation[1, 0], transform.rotation[0, 0])
