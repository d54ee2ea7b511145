"""Safety checks: a fault or None; NaN fails."""

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from wbc_controller.records import Array, Fault

TORQUE_TOLERANCE = 0.01  # share of an effort limit by which a solution may exceed the available torque, before clipping


def stale_inputs(
    ages: Mapping[str, float], limit: float, notes: Callable[[], Mapping[str, str]] = dict
) -> Fault | None:
    """Check ages of inputs, s (inf before the first); `notes` returns remarks by input."""
    parts = []
    for name, age in ages.items():
        if not (age <= limit):
            text = "has not arrived" if not math.isfinite(age) else f"is {1e3 * age:.0f} ms old"
            note = notes().get(name)
            parts.append(f"{name} {text} (limit {1e3 * limit:.0f} ms)" + (f"; {note}" if note else ""))
    return Fault("STALE_INPUT", "; ".join(parts)) if parts else None


def unusable_torques(tau: Array, available: tuple[Array, Array], limits: Array, actuators: Sequence[str]) -> Fault:
    """Return the fault of torques that are not finite or exceed the bounds, (na,) in N·m."""
    lower, upper = available
    excess = TORQUE_TOLERANCE * limits
    good = (tau >= lower - excess) & (tau <= upper + excess)
    bound = np.where(tau < 0.0, -lower, upper)
    worst = [f"{actuators[i]}: {tau[i]:.3g} N·m (limit {bound[i]:.3g})" for i in map(int, np.flatnonzero(~good))]
    return Fault("BAD_TORQUE", "the solution's torques are not usable: " + ", ".join(worst))
