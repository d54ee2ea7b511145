"""Walks on uneven, inclined, slippery and soft ground."""

import math
from collections.abc import Mapping
from typing import Any

from wbc_controller.errors import ConfigurationError, valid_choices
from wbc_controller.settings.service import SensorQuality
from wbc_controller.validation.accuracy.walks import Walk, walk

#: Difference in height of the cells, upwards and downwards, m, their side, m, and the angle of the slopes, rad.
UNEVENNESS, CELL, ANGLE = 0.02, 0.4, math.radians(5.0)
#: Friction of the slippery ground, and stiffness of soft ground, N/m.
FRICTION, STIFFNESS = 0.4, 2.0e4
#: Distance of the terrain from the start, and its size, m.
_AHEAD, _WIDE = 0.5, 30.0
#: Velocity on terrain, as a share of `forward`.
SHARE = 0.6


def _flat_start(height: float) -> dict[str, Any]:
    return {"position": [-2.0, 0.0, height], "size": [2.0 + _AHEAD, _WIDE, height]}


def _slope(height: float, pitch: float) -> dict[str, Any]:
    return {"position": [_AHEAD, 0.0, height], "size": [_WIDE, _WIDE, 0.2], "rpy": [0.0, pitch, 0.0]}


def terrain_of(ground: str, seed: int) -> Mapping[str, Any]:
    """Return the settings of the mock robot for a ground, by dotted key.

    Raises:
        ConfigurationError: if the ground is unknown.
    """
    cells = {"position": [_AHEAD, 0.0, UNEVENNESS], "size": [12.0, 8.0, 0.1], "unevenness": UNEVENNESS, "cell": CELL}
    across = {"position": [0.0, 0.25, 0.0], "size": [_WIDE, 2.0 * _WIDE, 0.2], "rpy": [0.0, -ANGLE, 0.5 * math.pi]}
    grounds: dict[str, dict[str, Any]] = {
        "flat": {},
        "uneven": {"mock.terrain": {"start": _flat_start(UNEVENNESS), "cells": {**cells, "seed": seed}}},
        "up": {"mock.terrain": {"slope": _slope(0.0, -ANGLE)}},
        "down": {"mock.terrain": {"start": _flat_start(2.0), "slope": _slope(2.0, ANGLE)}},
        "across": {"mock.terrain": {"slope": across}},
        "slippery": {"mock.friction": FRICTION},
        "soft": {"mock.terrain": {"mat": {**_flat_start(0.1), "size": [_WIDE, _WIDE, 0.1], "stiffness": STIFFNESS}}},
    }
    if ground not in grounds:
        raise ConfigurationError(f"unknown ground {ground!r}; {valid_choices(ground, grounds)}")
    return grounds[ground]


#: Grounds of the table.
GROUNDS = ("flat", "uneven", "up", "down", "across", "slippery", "soft")


def walk_on(robot: str, ground: str, sensors: SensorQuality, seed: int, seconds: float) -> Walk:
    """Walk onto a ground, stop and stand; across a slope also sideways."""
    command = "diagonal" if ground == "across" else "forward"
    return walk(robot, command, sensors, seed, seconds, SHARE, terrain_of(ground, seed))
