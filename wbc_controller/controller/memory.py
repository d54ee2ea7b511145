"""What a controller remembers from one cycle to the next, taken and given back: so that a recording can go on from it.

A class lists the attributes that outlive a cycle in ``STATE_FIELDS``; values with such a list are saved likewise.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from wbc_controller.controller.live_settings import LivePart
from wbc_controller.controller.result import CycleResult
from wbc_controller.inverse_dynamics.references.changes import Change
from wbc_controller.records import Array, ChangeSettings, Fault, RobotState


@dataclass(slots=True)  # not frozen, which would take three times as long to make, in every cycle
class Taped:
    """What one cycle was given, and what it gave.

    Attributes:
        now: s, on the clock of the loop.
        state: the latched state, where there is one.
        joint_velocity: joint velocities, (nj,) in rad/s; None where they are not fresh.
        problem: what was wrong with the inputs, or around the cycle.
        requests: words for the supervisor.
        changes: sets of changes.
        live: the part of the settings that was in force.
        result: what the cycle gave.
        apart: whether something has changed beside the cycles since the last one: a cycle that failed, or the end of
            the loop, which may have begun anew.
    """

    now: float
    state: RobotState | None
    joint_velocity: Array | None
    problem: Fault | None
    requests: tuple[str, ...]
    changes: tuple[Sequence[Change | ChangeSettings], ...]
    live: LivePart
    result: CycleResult
    apart: bool


def taken(owner: Any) -> dict[str, Any]:
    """The memory of an object, by attribute: what is written in place is copied, which records never are."""
    return {name: _copied(getattr(owner, name)) for name in owner.STATE_FIELDS}


def give_back(owner: Any, memory: Mapping[str, Any]) -> None:
    """Put back into an object what `taken` gave; it goes on as the one that it was taken from."""
    for name in owner.STATE_FIELDS:
        present, value = getattr(owner, name), memory[name]
        if hasattr(type(present), "STATE_FIELDS"):
            if value is not None:
                give_back(present, value)
        elif isinstance(present, np.ndarray) and present.flags.writeable:
            present[...] = value  # in place: compiled code may be bound to it
        else:
            setattr(owner, name, type(present)(value) if isinstance(present, deque | dict | tuple) else value)


def _copied(value: Any) -> Any:
    if hasattr(type(value), "STATE_FIELDS"):
        return taken(value)
    if isinstance(value, deque):
        return list(value)
    if isinstance(value, np.ndarray) and value.flags.writeable:
        return np.array(value)
    return dict(value) if isinstance(value, Mapping) else value
