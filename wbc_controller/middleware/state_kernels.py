"""The state that the newest joint states and odometry make, in one call (`nodes.inputs`)."""

from __future__ import annotations

import numpy as np

from wbc_controller.compiled import BYTES, NUMBER, TABLE, VECTOR_OUT, as_part, compile_all, compiled, table_at, vector
from wbc_controller.middleware.message_kernels import assemble, read
from wbc_controller.middleware.stamp_kernels import SIZE, STOOD, accept, age_of, is_plain, notice
from wbc_controller.records import Array

_read, _assemble = as_part(read), as_part(assemble)


@compiled(
    BYTES, BYTES, TABLE, NUMBER, NUMBER, NUMBER, NUMBER, NUMBER,
    VECTOR_OUT, VECTOR_OUT, VECTOR_OUT, VECTOR_OUT, VECTOR_OUT, VECTOR_OUT,
)  # fmt: skip
def latch(
    joint_states: bytes,
    odometry: bytes,
    tables: np.ndarray,
    came: float,
    odometry_came: float,
    now: float,
    ahead: float,
    tolerance: float,
    positions: Array,
    velocities: Array,
    pose: Array,
    twist: Array,
    q: Array,
    v: Array,
) -> tuple[int, float, float, float]:
    """Read joint states and odometry of known shapes, judge their stamps, and assemble the state.

    It is `messages.read` and `stamps.judged` of both, and `messages.assemble`; where one of them needs a closer look,
    nothing is remembered of either message.

    Args:
        joint_states: a message.
        odometry: a message; empty where no new one has come, or the base is fixed.
        tables: those of `messages.read` for joint states and odometry, what is remembered of their stamps, and the
            table of `messages.assemble`; 0 for what concerns odometry where the base is fixed.
        came: when the joint states came, s.
        odometry_came: likewise.
        now: s, on the same clock.
        ahead: time of the stamps' clock less ours, s, where it is known.
        tolerance: how far a stamp may be ahead of that clock, s.
        positions: takes those of the joints, (nj,).
        velocities: takes those of the joints, (nj,).
        pose: position and quaternion of a floating base, (7,), and (0,) of a fixed one; a message overwrites it.
        twist: of that base, (6,) or (0,), likewise.
        q: takes the configuration, (nq,).
        v: takes the velocity, (nv,).

    Returns:
        Stamp of the joint states, ns, negative where something needs a closer look; ages of joint states and odometry,
        s; and how far the stamps have gone on while our clock stood still, s.
    """
    stamp, base_stamp = _read(joint_states, table_at(tables, 0), positions, velocities), 1
    if len(odometry) and stamp > 0:
        base_stamp = _read(odometry, table_at(tables, 1), pose, twist)
    if not (stamp > 0 and base_stamp > 0):
        return -1, 0.0, 0.0, 0.0
    memory = vector(tables, 2, SIZE)
    base_memory = vector(tables, 3, SIZE) if tables[3] else memory
    if not is_plain(memory, stamp, came, ahead, tolerance):
        return -1, 0.0, 0.0, 0.0
    if len(odometry):
        if not is_plain(base_memory, base_stamp, odometry_came, ahead, tolerance):
            return -1, 0.0, 0.0, 0.0
        notice(base_memory, base_stamp, odometry_came)
        accept(base_memory, base_stamp, odometry_came)
    notice(memory, stamp, came)
    accept(memory, stamp, came)
    _assemble(table_at(tables, 4), positions, velocities, pose, twist, q, v)
    stood = max(memory[STOOD], base_memory[STOOD])
    return stamp, age_of(memory, now, ahead), age_of(base_memory, now, ahead), stood


compile_all()
