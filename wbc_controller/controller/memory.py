"""State that a controller keeps between cycles: saved in recordings, and restored for replay.

A class lists the attributes that outlive a cycle in ``STATE_FIELDS``; values with such a list are saved likewise. An
array is either read-only in all cycles, and replaced, or writable in all cycles, and then no other attribute refers to
it: compiled code may be bound to it, and it is restored in place.
"""

from __future__ import annotations

import reprlib
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, is_dataclass
from typing import Any

import numpy as np

from wbc_controller.controller.live_settings import LivePart
from wbc_controller.controller.report import CycleInputs
from wbc_controller.controller.result import CycleResult


@dataclass(slots=True)  # not frozen, which would take three times as long to make, in every cycle
class CycleRecord:
    """Inputs and result of one cycle, for a recording.

    Attributes:
        inputs: the inputs of the controller.
        live: the part of the settings that was in force.
        result: the result of the cycle.
        changed_outside: whether the state of the controller changed outside of its cycles since the last one: a cycle failed, or
            the loop ended, and may have started again.
    """

    inputs: CycleInputs
    live: LivePart
    result: CycleResult
    changed_outside: bool


def save_state(owner: Any) -> dict[str, Any]:
    """State of an object, by attribute; arrays that are written in place are copied."""
    return {name: _copied(getattr(owner, name)) for name in owner.STATE_FIELDS}


def restore_state(owner: Any, memory: Mapping[str, Any]) -> None:
    """Restore the state of an object from `save_state`.

    Raises:
        TypeError: if a record of the state is to become a value of another type.
    """
    for name in owner.STATE_FIELDS:
        present, value = getattr(owner, name), memory[name]
        _require_record(name, present, value)
        if hasattr(type(present), "STATE_FIELDS"):
            if value is not None:
                restore_state(present, value)
        elif isinstance(present, np.ndarray) and present.flags.writeable:
            present[...] = value  # in place: compiled code may be bound to it
        else:
            setattr(owner, name, type(present)(value) if isinstance(present, deque | dict | tuple) else value)


def _require_record(name: str, present: Any, value: Any) -> None:
    """Raise `TypeError` if a record, or one in a mapping by the same key, is to become a value of another type."""
    if isinstance(present, Mapping) and isinstance(value, Mapping):
        for key in present.keys() & value.keys():
            _require_record(f"{name}[{key!r}]", present[key], value[key])
    elif is_dataclass(present) and value is not None and type(value) is not type(present):
        raise TypeError(f"{name} is {reprlib.repr(value)}, not a {type(present).__name__}")


def _copied(value: Any) -> Any:
    if hasattr(type(value), "STATE_FIELDS"):
        return save_state(value)
    if isinstance(value, deque):
        return list(value)
    if isinstance(value, np.ndarray) and value.flags.writeable:
        return np.array(value)
    return dict(value) if isinstance(value, Mapping) else value
