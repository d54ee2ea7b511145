"""Parser of ``+0.02 forward``, ``20mm up``, ``10deg left``."""

import math
import re
from collections.abc import Mapping, Sequence

import numpy as np

from wbc_controller.errors import InputRefused, require_known, valid_choices
from wbc_controller.records import Array

_Axes = Mapping[str, tuple[int, int, int]]
#: Directions along the axes of the robot's heading, and of the world.
HEADINGS: _Axes = {
    "forward": (1, 0, 0), "back": (-1, 0, 0),
    "left": (0, 1, 0), "right": (0, -1, 0),
    "up": (0, 0, 1), "down": (0, 0, -1),
}  # fmt: skip
AXES: _Axes = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
#: Rotation axes of a turn and a lean, in heading axes, by direction.
ROTATIONS: Mapping[str, _Axes] = {
    "turn": {"left": (0, 0, 1), "right": (0, 0, -1)},
    "lean": {"forward": (0, 1, 0), "back": (0, -1, 0), "left": (-1, 0, 0), "right": (1, 0, 0)},
}

#: Units that may follow a number without a space.
LENGTH = {"": 1.0, "m": 1.0, "cm": 0.01, "mm": 0.001}
ANGLE = {"": 1.0, "rad": 1.0, "deg": math.pi / 180.0}
FORCE = {"": 1.0, "N": 1.0}
TIME = {"": 1.0, "s": 1.0, "ms": 0.001}
PLAIN = {"": 1.0}
_NUMBER = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)([A-Za-z]*)")


def number(text: str, subject: str, units: Mapping[str, float] = PLAIN) -> float:
    """Return a number in SI units; raise `InputRefused` otherwise."""
    match = _NUMBER.fullmatch(text)
    if match is None:
        raise InputRefused(f"{subject}: expected a number, got {text!r}")
    if match[2] not in units:
        raise InputRefused(f"{subject}: unknown unit in {text!r}; {valid_choices(match[2], [u for u in units if u])}")
    return float(match[1]) * units[match[2]]


def displacement(words: Sequence[str], subject: str, units: Mapping[str, float]) -> tuple[Array, bool]:
    """Return the sum of pairs such as ``0.02 forward 0.01 down``, (3,), and whether it has the axes of the heading.

    The other axes are those of the world. Raises `InputRefused` for words of another form, or of both kinds of axes.
    """
    if not words or len(words) % 2:
        raise InputRefused(
            f"{subject} requires pairs of a number and a direction, such as 0.02 forward; got {' '.join(words)!r}"
        )
    known = {**HEADINGS, **AXES}
    total, directions = np.zeros(3), words[1::2]
    for amount, direction in zip(words[::2], directions, strict=True):
        require_known(direction, known, f"{subject}: unknown direction", error=InputRefused)
        total += number(amount, subject, units) * np.array(known[direction])
    level = {"up", "down", "z"}  # the same in both
    by_heading, by_axes = (set(directions) & set(names) - level for names in (HEADINGS, AXES))
    if by_heading and by_axes:
        raise InputRefused(
            f"{subject}: {' '.join(words)!r} mixes directions of the robot with axes x, y, z of the world; use one kind"
        )
    return total, not by_axes


def turn(words: Sequence[str], axes: _Axes, subject: str) -> Array:
    """Return ``ANGLE DIRECTION`` as a rotation vector in heading axes, (3,) in rad; raise `InputRefused` otherwise."""
    if len(words) != 2:
        raise InputRefused(f"{subject} requires an angle and a direction, such as 10deg left; got {' '.join(words)!r}")
    require_known(words[1], axes, f"{subject}: unknown direction", error=InputRefused)
    return number(words[0], subject, ANGLE) * np.array(axes[words[1]])


def quaternion(rotation: Array) -> Array:
    """Return the quaternion (x, y, z, w) of a rotation vector, (3,) in rad."""
    angle = float(np.linalg.norm(rotation))
    axis = rotation / angle if angle > 0.0 else np.zeros(3)
    return np.array([*(math.sin(0.5 * angle) * axis), math.cos(0.5 * angle)])
