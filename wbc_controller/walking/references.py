"""References at fixed rates, and the smooth step."""

import math
from collections.abc import Sequence

import numpy as np

from wbc_controller.records import Array, Reference

#: Rate at which a height follows its goal, 1/s, and its largest rate, m/s.
_HEIGHT_RATE, _FASTEST_HEIGHT = 3.0, 0.2


def reference(position: Array | Sequence[float], velocity: Sequence[float]) -> Reference:
    """Return a reference without acceleration."""
    return Reference(np.array(position), np.array(velocity), np.zeros(len(velocity)))


def turned(quaternion: Sequence[float], angle: float) -> list[float]:
    """Return a quaternion (x, y, z, w), turned about the vertical by an angle in rad."""
    (x, y, z, w), c, s = quaternion, math.cos(0.5 * angle), math.sin(0.5 * angle)
    return [c * x - s * y, c * y + s * x, c * z + s * w, c * w - s * z]


def smooth_step(share: float) -> tuple[float, float]:
    """Return the quintic from 0 to 1 at a share of its duration, and its derivative."""
    s = max(0.0, min(1.0, share))
    return s**3 * (10.0 - 15.0 * s + 6.0 * s * s), 30.0 * s * s * (1.0 - s) ** 2


def height_rate(distance: float) -> float:
    """Return the rate at which a height reference follows a goal at a distance in m, m/s."""
    return max(-_FASTEST_HEIGHT, min(_FASTEST_HEIGHT, _HEIGHT_RATE * distance))
