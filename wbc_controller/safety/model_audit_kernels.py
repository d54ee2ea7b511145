"""The sums of the audit over the states of a span (`safety.model_audit`, which has the equations)."""

from wbc_controller.compilation import Matrix, OutVector, StridedMatrix, StridedVector, Struct, compiled


class AuditMemory(Struct):
    """The previous state with the motion predicted from it, and the sums since the span began.

    Attributes:
        S: actuation matrix, (na, nv).
        mass: mass of the robot, kg.
        v: generalized velocity in the previous state, (nv,).
        v_dot: generalized acceleration predicted from it, (nv,).
        tau: torques sent in it, (na,) in N·m.
        momentum: linear momentum in it, m ċ, (3,) in N·s.
        force: its predicted rate m c̈, (3,) in N.
        velocity: sum of the unexplained changes of the velocity, Δv - v̇ Δt, (nv,).
        impulse: sum of the unexplained impulses, Δ(m ċ) - m c̈ Δt, (3,) in N·s.
        totals: time for which the motion was predicted, s; work of the torques and of known other forces, J; sum of its
            magnitudes, J.
    """

    S: Matrix
    mass: float
    v: OutVector
    v_dot: OutVector
    tau: OutVector
    momentum: OutVector
    force: OutVector
    velocity: OutVector
    impulse: OutVector
    totals: OutVector


@compiled
def add_step(
    memory: AuditMemory, step: StridedVector, v: StridedVector, com_velocity: StridedVector, other: StridedVector,
    duration: float, predicted: bool,
) -> None:  # fmt: skip
    """Add the step from the previous state to this one to the sums.

    Args:
        step: Δq, (nv,).
        v: generalized velocity in this state, (nv,).
        com_velocity: velocity of the centre of mass in it, (3,) in m/s.
        other: known generalized force besides the torques, (nv,).
        duration: time between the two states Δt, s.
        predicted: whether the previous state's prediction is for the torques that were sent.
    """
    na, nv = memory.S.shape
    if not (len(step) == len(v) == len(other) == len(memory.velocity) == len(memory.v) == len(memory.v_dot) == nv):
        raise ValueError("add_step: a step, a velocity or a force has another size than v")
    if not (len(com_velocity) == len(memory.momentum) == len(memory.force) == len(memory.impulse) == 3):
        raise ValueError("add_step: a motion of the centre of mass has another size than 3")
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
def keep_state(
    memory: AuditMemory, v: StridedVector, com_velocity: StridedVector, com_jacobian: StridedMatrix,
    com_drift: StridedVector, v_dot: StridedVector, solved: StridedVector, sent: StridedVector,
) -> bool:  # fmt: skip
    """Keep this state for the next step.

    Args:
        v: generalized velocity, (nv,).
        com_velocity: velocity of the centre of mass, (3,) in m/s.
        com_jacobian: its Jacobian, (3, nv).
        com_drift: its acceleration at v̇ = 0, (3,) in m/s².
        v_dot: generalized acceleration of the solution, (nv,).
        solved: torques of the solution, (na,) in N·m.
        sent: torques sent, (na,) in N·m.

    Returns:
        Whether the solution predicts the motion: its torques were sent.
    """
    na, nv = memory.S.shape
    if not (len(v) == len(v_dot) == com_jacobian.shape[1] == nv and len(solved) == len(sent) == na):
        raise ValueError("keep_state: a velocity, an acceleration or torques have another size than v or the actuators")
    if not (len(com_velocity) == len(com_drift) == len(com_jacobian) == 3):
        raise ValueError("keep_state: a motion of the centre of mass has another size than 3")
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
