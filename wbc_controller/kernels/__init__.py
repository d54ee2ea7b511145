"""The arithmetic of a control cycle on small arrays, as functions that are compiled to machine code.

A cycle makes some hundred NumPy calls on arrays of a few dozen numbers if it is written with NumPy, and nearly all the
time goes into the calls. Here are the loops themselves, with their equations; what the quantities mean, and which of
them there are, is said by the classes above.

Importing this package compiles them all, or loads what was compiled before.
"""

from wbc_controller.kernels import (
    active_set,
    audit,
    equations_of_motion,
    frames,
    invariant_filter,
    joint_motion,
    leg_kinematics,
    messages,
    placements,
    program,
    self_collision,
    stamps,
    states,
    supervision,
)
from wbc_controller.kernels.compiled import compile_all

compile_all()

__all__ = [
    "active_set",
    "audit",
    "equations_of_motion",
    "frames",
    "invariant_filter",
    "joint_motion",
    "leg_kinematics",
    "messages",
    "placements",
    "program",
    "self_collision",
    "stamps",
    "states",
    "supervision",
]
