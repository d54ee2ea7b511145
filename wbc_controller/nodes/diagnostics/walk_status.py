"""Diagnostics of a walking robot."""

from __future__ import annotations

import math

from wbc_controller.walking.footsteps import Velocity
from wbc_controller.walking.walker import Walker


def walk_values(walker: Walker | None) -> dict[str, str]:
    """Return the values by key; none without a walker."""
    if walker is None:
        return {}
    values = {
        "walking/phase": walker.phase.value,
        "walking/steps": str(walker.steps),
        "walking/command": "none" if walker.command is None else _text(walker.command),
    }
    if walker.goal is not None:
        goal = walker.goal
        values["walking/goal"] = f"{goal.place.real:.3f} {goal.place.imag:.3f} m, {goal.heading:.3f} rad"
    plan = walker.plan()
    if plan is None:
        return values
    values["walking/velocity"] = _text(walker.velocity)
    values["walking/margin"] = f"{plan.margin:.4f} m"
    values["walking/dcm_error"] = f"{abs(plan.dcm - plan.wanted_dcm):.4f} m"
    if math.isfinite(plan.remaining):
        values["walking/touchdown"] = f"{plan.remaining:.3f} s"
    return values


def _text(velocity: Velocity) -> str:
    return f"{velocity.linear.real:.3f} {velocity.linear.imag:.3f} m/s, {velocity.turning:.3f} rad/s"
