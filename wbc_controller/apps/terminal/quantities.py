"""Reads quantities and directions as people write them: ``+0.02 forward``, ``20mm up``, ``10deg left``."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

import numpy as np

from wbc_controller.errors import InputRefused, valid_choices
from wbc_controller.records import Array

#: Directions by the robot's heading, and along the axes of the world.
HEADINGS: Mapping[str, tuple[int, int, int]] = {
    "forward": (1, 0, 0),
    "back": (-1, 0, 0),
    "left": (0, 1, 0),
    "right": (0, -1, 0),
    "up": (0, 0, 1),
    "down": (0, 0, -1),
}
AXES: Mapping[str, tuple[int, int, int]] = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
#: Axes about which the head of who leans goes in a direction, by the robot's heading.
LEANS: Mapping[str, tuple[int, int, int]] = {
    "forward": (0, 1, 0),
    "back": (0, -1, 0),
    "left": (-1, 0, 0),
    "right": (1, 0, 0),
}
TURNS: Mapping[str, tuple[int, int, int]] = {"left": (0, 0, 1), "right": (0, 0, -1)}

#: Units that may follow a number, without a space.
LENGTH = {"": 1.0, "m": 1.0, "cm": 0.01, "mm": 0.001}
ANGLE = {"": 1.0, "rad": 1.0, "deg": math.pi / 180.0}
FORCE = {"": 1.0, "N": 1.0}
TIME = {"": 1.0, "s": 1.0, "ms": 0.001}
PLAIN = {"": 1.0}
_NUMBER = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)([A-Za-z]*)")


def number(text: str, what: str, units: Mapping[str, float] = PLAIN) -> float:
    """Read a number with its unit.

    Raises:
        InputRefused: where it is none, or the unit is another.
    """
    match = _NUMBER.fullmatch(text)
    if match is None:
        raise InputRefused(f"{what} is a number, not {text!r}")
    if match[2] not in units:
        raise InputRefused(f"{what} is {text!r}: unknown unit; {valid_choices(match[2], [u for u in units if u])}")
    return float(match[1]) * units[match[2]]


def displacement(words: Sequence[str], what: str, units: Mapping[str, float]) -> tuple[Array, bool]:
    """Read pairs of a number and a direction, such as ``0.02 forward 0.01 down``, and add them up.

    Returns:
        Their sum, (3,), and whether it is given by the robot's heading; otherwise along the axes of the world.

    Raises:
        InputRefused: where it is no such sentence, or mixes both.
    """
    if not words or len(words) % 2:
        raise InputRefused(f"{what} takes pairs of a number and a direction, such as 0.02 forward, not {_said(words)}")
    known = {**HEADINGS, **AXES}
    total, directions = np.zeros(3), words[1::2]
    for amount, direction in zip(words[::2], directions, strict=True):
        if direction not in known:
            raise InputRefused(f"{what}: {direction!r} is no direction; {valid_choices(direction, known)}")
        total += number(amount, what, units) * np.array(known[direction])
    level = {"up", "down", "z"}  # the same in both
    by_heading, by_axes = (set(directions) & set(names) - level for names in (HEADINGS, AXES))
    if by_heading and by_axes:
        raise InputRefused(f"{what}: {_said(words)} mixes the robot's directions with the world's axes x, y, z")
    return total, not by_axes


def turn(words: Sequence[str], axes: Mapping[str, tuple[int, int, int]], what: str) -> Array:
    """Read an angle and a direction, such as ``10deg left``, as a rotation vector by the robot's heading, (3,) in rad.

    Raises:
        InputRefused: where it is no such sentence.
    """
    if len(words) != 2:
        raise InputRefused(f"{what} takes an angle and a direction, such as 10deg left, not {_said(words)}")
    if words[1] not in axes:
        raise InputRefused(f"{what}: {words[1]!r} is no direction; {valid_choices(words[1], axes)}")
    return number(words[0], what, ANGLE) * np.array(axes[words[1]])


def quaternion(rotation: Array) -> Array:
    """Quaternion (x, y, z, w) of a rotation vector, (3,) in rad."""
    angle = float(np.linalg.norm(rotation))
    axis = rotation / angle if angle > 0.0 else np.zeros(3)
    return np.array([*(math.sin(0.5 * angle) * axis), math.cos(0.5 * angle)])


def _said(words: Sequence[str]) -> str:
    return repr(" ".join(words))
