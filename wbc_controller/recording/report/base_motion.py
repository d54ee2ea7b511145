"""Mean velocity of the base in its heading."""

import math

import numpy as np

from wbc_controller.records import Array


def mean_velocity(way: Array, begin: float, end: float) -> Array:
    """Return the mean velocity in the heading between two times in s, (3,) in m/s and rad/s.

    `way`: times in s, x and y in m and heading in rad, (n, 4).
    """
    part = way[(way[:, 0] >= begin) & (way[:, 0] <= end)]
    headings = np.unwrap(part[:, 3])
    steps = np.diff(part[:, 1] + 1j * part[:, 2]) * np.exp(-0.5j * (headings[1:] + headings[:-1]))
    moved = steps.sum()
    change = np.array([moved.real, moved.imag, headings[-1] - headings[0]])
    return change / float(part[-1, 0] - part[0, 0])


def heading(q: Array) -> float:
    """Return the heading of a floating base, rad."""
    x, y, z, w = q[3:7].tolist()
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
