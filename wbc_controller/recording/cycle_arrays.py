"""Cycles of a recording as arrays."""

from __future__ import annotations

import numpy as np

from wbc_controller.recording.cycle_layout import MODES, slot_slices
from wbc_controller.recording.recording_file import Recording
from wbc_controller.records import Array


def cycle_arrays(recording: Recording) -> dict[str, Array]:
    """Return the cycles with a sent command as arrays by slot, with the references.

    Numbers are (n,), vectors (n, k), absent values NaN; ``stamp`` and ``time`` are in ns, ``mode`` contains names.
    Empty without commands.
    """
    rows, stamps, times = [], [], []
    absent = np.full(sum(slot.size for slot in recording.slots if slot.group == "references"), np.nan)
    for cycle in recording.cycles():
        if not cycle.scalar("has_command") or np.isnan(cycle.scalar("seconds/total")):  # not sent
            continue
        rows.append(np.concatenate([*cycle.values.values(), *(cycle.references.values() or [absent])]))
        stamps.append(cycle.stamp)
        times.append(cycle.time)
    if not rows:
        return {}
    table = np.array(rows)
    arrays: dict[str, Array] = {}
    for slot, place in slot_slices(recording.slots):
        single = slot.size == 1 and (slot.group == "cycle" or slot.name.startswith(("weight/", "contact/")))
        if slot.name not in arrays:  # `references` repeats ``number``
            arrays[slot.name] = table[:, place.start] if single else table[:, place]
    return {
        **arrays,
        "number": arrays["number"].astype(np.int64),
        "stamp": np.array(stamps),
        "time": np.array(times),
        "mode": np.array([MODES[int(mode)].value for mode in arrays["mode"]]),
    }
