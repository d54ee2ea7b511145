"""Kernels of `safety.model_audit`."""

from wbc_controller.compilation import Matrix, OutVector, StridedMatrix, StridedVector, Struct, compiled


class AuditMemory(Struct):
    """Previous state with its predicted motion, and sums since the start of the span."""

    S: Matrix  # actuation matrix, (na, nv)
    mass: float  # of the robot, kg
    v: OutVector  # (nv,)
    v_dot: OutVector  # predicted, (nv,)
    tau: OutVector  # torques sent, (na,) in N·m
    momentum: OutVector  # linear momentum m ċ, (3,) in N·s
    force: OutVector  # predicted m c̈, (3,) in N
    velocity: OutVector  # sum of Δv - v̇ Δt, (nv,)
    impulse: OutVector  # sum of Δ(m ċ) - m c̈ Δt, (3,) in N·s
    totals: OutVector  # predicted time, s; work of torques and known forces, J; its magnitudes, J


@compiled
def add_step(
    memory: AuditMemory, step: StridedVector, v: StridedVector, com_velocity: StridedVector, other: StridedVector,
    duration: float, predicted: bool,
) -> None:  # fmt: skip
    """Add a step Δq, (nv,), within `duration`, s, to the sums.

    The velocities v and `com_velocity` are those at its end; `other` is the known force besides the torques, (nv,).
    """
    na, nv = memory.S.shape
    if not (len(step) == len(v) == len(other) == len(memory.velocity) == len(memory.v) == len(memory.v_dot) == nv):
        raise ValueError("add_step: step, v and other must have size nv")
    if not (len(com_velocity) == len(memory.momentum) == len(memory.force) == len(memory.impulse) == 3):
        raise ValueError("add_step: motions of the centre of mass must have size 3")
    for k in range(nv):  # (Sᵀτ + p)ₖ Δqₖ; contact forces do no work
        force = other[k]
        for i in range(na):
            force += memory.S[i, k] * memory.tau[i]
        memory.totals[1] += force * step[k]
        memory.totals[2] += abs(force * step[k])
    if predicted:
        memory.totals[0] += duration
        for k in range(nv):
            memory.velocity[k] += v[k] - memory.v[k] - duration * memory.v_dot[k]
        for k in range(3):
            momentum = memory.mass * com_velocity[k]
            memory.impulse[k] += momentum - memory.momentum[k] - duration * memory.force[k]


@compiled
def store_state(
    memory: AuditMemory, v: StridedVector, com_velocity: StridedVector, com_jacobian: StridedMatrix,
    com_drift: StridedVector, v_dot: StridedVector, solved: StridedVector, sent: StridedVector,
) -> bool:  # fmt: skip
    """Store this state for the next step; return True if `sent` are the torques `solved` by the QP."""
    na, nv = memory.S.shape
    if not (len(v) == len(v_dot) == com_jacobian.shape[1] == nv and len(solved) == len(sent) == na):
        raise ValueError("store_state: v, v_dot and com_jacobian must have nv columns, torques size na")
    if not (len(com_velocity) == len(com_drift) == len(com_jacobian) == 3):
        raise ValueError("store_state: motions of the centre of mass must have size 3")
    memory.v[:], memory.v_dot[:], memory.tau[:] = v, v_dot, sent
    for k in range(3):
        acceleration = com_drift[k]
        for i in range(nv):
            acceleration += com_jacobian[k, i] * v_dot[i]
        memory.momentum[k], memory.force[k] = memory.mass * com_velocity[k], memory.mass * acceleration
    predicts = True
    for i in range(na):
        predicts &= solved[i] == sent[i]
    return predicts
