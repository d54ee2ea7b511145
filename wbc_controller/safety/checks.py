"""Safety checks as pure functions: each returns a fault, or None if the check passes.

All comparisons are written so that NaN fails them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from wbc_controller.core.arrays import all_true
from wbc_controller.records import Array, Fault


def stale_inputs(ages: Mapping[str, float], limit: float, notes: Mapping[str, str] | None = None) -> Fault | None:
    """Check that no input is older than a limit.

    Args:
        ages: age of each input, s; infinite where none has arrived.
        limit: largest allowed age, s.
        notes: for inputs whose last message was refused, the reason.
    """
    parts = []
    for name, age in ages.items():
        if not (age <= limit):
            said = "has not arrived" if not math.isfinite(age) else f"is {1e3 * age:.0f} ms old"
            note = (notes or {}).get(name)
            parts.append(f"{name} {said} (limit {1e3 * limit:.0f} ms)" + (f"; last refusal: {note}" if note else ""))
    return Fault("STALE_INPUT", "; ".join(parts)) if parts else None


def torques_usable(
    tau: Array,
    limits: Array,
    actuators: Sequence[str],
    tolerance: float = 0.01,
    available: tuple[Array, Array] | None = None,
) -> Fault | None:
    """Check that torques are finite and within their limits.

    Args:
        tau: torques of the actuators, (na,) in N·m.
        limits: effort limits, (na,) in N·m.
        actuators: names, (na,).
        tolerance: share of an effort limit by which a solver may exceed a bound; the supervisor clips the excess.
        available: lower and upper bounds of the torques available at the present speeds, both (na,) in N·m; None where
            they are the effort limits.
    """
    if available is None:
        good = np.abs(tau) <= (1.0 + tolerance) * limits
    else:
        lower, upper = available
        good = (tau >= lower - tolerance * limits) & (tau <= upper + tolerance * limits)
    if all_true(good):
        return None
    lower, upper = (-limits, limits) if available is None else available
    bound = np.where(tau < 0.0, -lower, upper)
    worst = [f"{actuators[i]}: {tau[i]:.3g} N·m (limit {bound[i]:.3g})" for i in map(int, np.flatnonzero(~good))]
    return Fault("BAD_TORQUE", "the solution's torques are not usable: " + ", ".join(worst))
