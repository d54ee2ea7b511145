"""All that depends on the state in a quadratic program, in one call."""

from __future__ import annotations

import numpy as np

from wbc_controller.compiled import NUMBER, TABLE, VECTOR, VECTOR_OUT, as_part, compile_all, compiled, table_at
from wbc_controller.inverse_dynamics.limits.joint_motion_kernels import acceleration_bounds
from wbc_controller.inverse_dynamics.robot.dynamics_kernels import fill_dynamics
from wbc_controller.inverse_dynamics.robot.frame_kernels import fill_rows, link_terms
from wbc_controller.records import Array

_link_terms, _fill_rows = as_part(link_terms), as_part(fill_rows)
_fill_dynamics, _acceleration_bounds = as_part(fill_dynamics), as_part(acceleration_bounds)


@compiled(TABLE, VECTOR, VECTOR, VECTOR, VECTOR, NUMBER, VECTOR_OUT)
def fill_program(tables: np.ndarray, q: Array, v: Array, h: Array, before: Array, share: float, errors: Array) -> float:
    """The motion of links, rows of contacts and tasks, equations of motion, and bounds of torques and accelerations.

    It is `frames.link_terms`, `frames.fill_rows`, `equations_of_motion.fill_dynamics` and
    `joint_motion.acceleration_bounds`, which say what the arguments are, one after the other.

    Args:
        tables: their tables, in this order.
        q: configuration, (nq,).
        v: generalized velocity, (nv,).
        h: bias forces, (nv,).
        before: τ_before, (na,) in N·m.
        share: rate Δt; below 0 the change of the torques is not bounded.
        errors: for the task errors.

    Returns:
        The cost that no acceleration avoids, of the tasks on single accelerations.
    """
    _link_terms(table_at(tables, 0), v)
    rest = _fill_rows(table_at(tables, 1), q, v, errors)
    _fill_dynamics(table_at(tables, 2), h, v, before, share)
    _acceleration_bounds(table_at(tables, 3), q, v)
    return rest


compile_all()
