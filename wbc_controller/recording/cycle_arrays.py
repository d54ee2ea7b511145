"""The cycles of a recording as arrays."""

from __future__ import annotations

import numpy as np

from wbc_controller.recording.cycle_layout import MODES, places_of
from wbc_controller.recording.recording_file import Recording
from wbc_controller.records import Array


def cycle_arrays(recording: Recording) -> dict[str, Array]:
    """Return the cycles that sent a command, as arrays by the slots of `cycle_layout`, also those of the references.

    Returns:
        (n,) for single numbers such as ``number``, (n, k) for vectors; NaN if absent. ``stamp`` and ``time`` are in ns,
        ``mode`` contains names. Empty if no command was sent.
    """
    rows, stamps, times = [], [], []
    absent = np.full(sum(slot.size for slot in recording.slots if slot.group == "references"), np.nan)
    for cycle in recording.cycles():
        if not cycle.number_of("has_command") or np.isnan(cycle.number_of("seconds/total")):  # computed, but not sent
            continue
        rows.append(np.concatenate([*cycle.values.values(), *(cycle.references.values() or [absent])]))
        stamps.append(cycle.stamp)
        times.append(cycle.time)
    if not rows:
        return {}
    table = np.array(rows)
    arrays: dict[str, Array] = {}
    for slot, place in places_of(recording.slots):
        single = slot.size == 1 and (slot.group == "cycle" or slot.name.startswith(("weight/", "contact/")))
        if slot.name not in arrays:  # the references repeat the number of their cycle
            arrays[slot.name] = table[:, place.start] if single else table[:, place]
    return {
        **arrays,
        "number": arrays["number"].astype(np.int64),
        "stamp": np.array(stamps),
        "time": np.array(times),
        "mode": np.array([MODES[int(mode)].value for mode in arrays["mode"]]),
    }
