"""Transforms between worlds with common vertical: a rotation about z and a translation.

Worlds without absolute poses differ by such a transform, as heading and position are unobservable.
"""

import math

import numpy as np
import pinocchio as pin

from wbc_controller.records import Array


def planar_transform(heading: float, x: Array, to: Array) -> pin.SE3:
    """Return the transform with a heading, rad, that maps a point x to `to`, (3,) in m."""
    c, s = math.cos(heading), math.sin(heading)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return pin.SE3(R, to - R @ x)


def heading_of(transform: pin.SE3) -> float:
    """Return the rotation about z, rad."""
    return math.atan2(transform.rotation[1, 0], transform.rotation[0, 0])
