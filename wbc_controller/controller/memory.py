"""State between cycles, for recordings and replay.

``STATE_FIELDS`` of a class lists its state attributes, recursively. Read-only arrays are replaced. Writable arrays are
restored in place, as compiled code may be bound to them, and must not be shared by attributes.
"""

import reprlib
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, is_dataclass
from typing import Any

import numpy as np

from wbc_controller.controller.live_settings import LivePart
from wbc_controller.controller.report import CycleInputs
from wbc_controller.controller.result import CycleResult


@dataclass(slots=True)  # not frozen: faster construction
class CycleRecord:
    """Inputs and result of one cycle, for a recording."""

    inputs: CycleInputs
    live: LivePart
    result: CycleResult
    changed_outside: bool  # True if the state changed since the last cycle


def save_state(owner: Any) -> dict[str, Any]:
    """Return the state of an object by attribute; writable arrays are copied."""
    return {name: _copied(getattr(owner, name)) for name in owner.STATE_FIELDS}


def restore_state(owner: Any, memory: Mapping[str, Any]) -> None:
    """Restore the state of an object from `save_state`; a record of the wrong type raises `TypeError`."""
    for name in owner.STATE_FIELDS:
        present, value = getattr(owner, name), memory[name]
        _require_record(name, present, value)
        if hasattr(type(present), "STATE_FIELDS"):
            if value is not None:
                restore_state(present, value)
        elif isinstance(present, np.ndarray) and present.flags.writeable:
            present[...] = value
        else:
            setattr(owner, name, type(present)(value) if isinstance(present, deque | dict | tuple) else value)


def _require_record(name: str, present: Any, value: Any) -> None:
    if isinstance(present, Mapping) and isinstance(value, Mapping):
        for key in present.keys() & value.keys():
            _require_record(f"{name}[{key!r}]", present[key], value[key])
    elif is_dataclass(present) and value is not None and type(value) is not type(present):
        raise TypeError(f"{name} = {reprlib.repr(value)}: expected {type(present).__name__}")


def _copied(value: Any) -> Any:
    if hasattr(type(value), "STATE_FIELDS"):
        return save_state(value)
    if isinstance(value, deque):
        return list(value)
    if isinstance(value, np.ndarray) and value.flags.writeable:
        return np.array(value)
    return dict(value) if isinstance(value, Mapping) else value
