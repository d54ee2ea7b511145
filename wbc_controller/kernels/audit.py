"""The balances of energy, momentum and joint torques over a span of states (`diagnostics.audit`)."""

from __future__ import annotations

import numpy as np

from wbc_controller.kernels.compiled import (
    ANY_MATRIX,
    ANY_VECTOR,
    NUMBER,
    ROWS_OUT,
    TABLE,
    VECTOR,
    VECTOR_OUT,
    compiled,
    indices,
    matrix,
    vector,
)
from wbc_controller.records import Array

#: Size and places of what is summed over a span: work and throughput in J, the time for which a motion was predicted in
#: s, the unexplained impulse (3,) in N·s; and of the last state the momentum (3,) in N·s, the force (3,) in N that was
#: predicted for the time after it, and whether that, and the motion, were predicted at all.
SUMS, WORK, THROUGHPUT, PREDICTED, IMPULSE, MOMENTUM, FORCE, PREDICTS = 13, 0, 1, 2, 3, 6, 9, 12


@compiled(ANY_MATRIX, ANY_VECTOR, VECTOR, ANY_VECTOR)
def mechanical_energy(M: Array, v: Array, weight: Array, com: Array) -> float:
    """The energy T + V = ½ vᵀM v - m gᵀc, J.

    Args:
        M: joint-space inertia matrix, (nv, nv).
        v: generalized velocity, (nv,).
        weight: m g, (3,) in N.
        com: centre of mass c, (3,) in m.
    """
    energy = 0.0
    for j in range(len(v)):
        momentum = 0.0
        for i in range(len(v)):
            momentum += M[i, j] * v[i]
        energy += 0.5 * momentum * v[j]
    for i in range(3):
        energy -= weight[i] * com[i]
    return energy


@compiled(TABLE, NUMBER, VECTOR, VECTOR, VECTOR, ANY_VECTOR, VECTOR, VECTOR, VECTOR)
def follow(
    table: np.ndarray, gap: float, beside: Array, moved: Array, q: Array, v: Array, v_dot: Array, tau: Array,
    tau_found: Array,
) -> bool:  # fmt: skip
    """Go on from one state to the next, and add up what the laws of motion say of the time between them.

    The work of the torques and of what acts beside them, (Sᵀτ + p)ᵀ Δq; where the motion was predicted, the unexplained
    impulse Δ(m ċ) - m c̈ Δt with c̈ = J v̇ + δ, and the unexplained change of the velocity Δv - v̇ Δt. Contact forces do
    no work.

    Args:
        table: the number k of entries of the actuation matrix S that are not zero, nq, nv and na; and, in this order,
            actuators: row of each of these entries, (k,).
            moved_by: its column, (k,).
            ratios: the entry itself, (k,).
            mass: m in kg, (1,).
            com_velocity: ċ at this state, (3,) in m/s.
            com_jacobian: J at this state, by columns, (nv, 6): its first three rows count.
            com_drift: δ, c̈ at v̇ = 0, at this state, (3,) in m/s².
            sums: what is summed, (SUMS,).
            vectors: the unexplained change of the velocity, which is summed too, and room for a generalized force,
                (2, nv).
            before: q, v, v̇, the torques sent, all one after the other, as they were given for the state before,
                (nq + 2 nv + na,); written for the next one.
        gap: Δt, s; 0 at the first state of all, before which there is nothing.
        beside: generalized force p that acts beside the torques, (nv,); (0,) where there is none.
        moved: change of the configuration, (nv,); (0,) to take it from q, for which no force may act on the base.
        q: configuration, (nq,): of the base, and then of one joint after the other.
        v: generalized velocity, (nv,).
        v_dot: v̇ of the solution at this state, (nv,).
        tau: torques sent at this state, (na,) in N·m.
        tau_found: torques of the solution at this state, (na,): where they are other ones, it predicts nothing.

    Returns:
        Whether the solution predicts the motion.
    """
    entries, nq, nv, na = table[0], table[1], table[2], table[3]
    actuators, moved_by, ratios = indices(table[4], entries), indices(table[5], entries), vector(table[6], entries)
    mass, com_velocity, com_drift = vector(table[7], 1)[0], vector(table[8], 3), vector(table[10], 3)
    com_jacobian, sums, vectors = matrix(table[9], nv, 6), vector(table[11], SUMS), matrix(table[12], 2, nv)
    before = vector(table[13], nq + 2 * nv + na)
    q_before, v_before, v_dot_before = before[:nq], before[nq : nq + nv], before[nq + nv : nq + 2 * nv]
    tau_before = before[nq + 2 * nv :]
    missed, force = vectors[0], vectors[1]
    predicted = sums[PREDICTS] > 0.0 and gap > 0.0
    if gap > 0.0:
        for j in range(nv):
            force[j] = beside[j] if len(beside) else 0.0
        for k in range(len(ratios)):
            force[moved_by[k]] += tau_before[actuators[k]] * ratios[k]
        shift = nq - nv
        for j in range(nv):
            if len(moved):
                work = force[j] * moved[j]
            elif force[j] != 0.0:
                work = force[j] * (q[j + shift] - q_before[j + shift])
            else:
                work = 0.0
            sums[WORK] += work
            sums[THROUGHPUT] += abs(work)
    if predicted:
        sums[PREDICTED] += gap
        for j in range(nv):
            missed[j] += v[j] - v_before[j] - gap * v_dot_before[j]
    for i in range(3):
        momentum = mass * com_velocity[i]
        acceleration = com_drift[i]
        for j in range(nv):
            acceleration += com_jacobian[j, i] * v_dot[j]
        if predicted:
            sums[IMPULSE + i] += momentum - sums[MOMENTUM + i] - gap * sums[FORCE + i]
        sums[MOMENTUM + i], sums[FORCE + i] = momentum, mass * acceleration
    predicts = True
    for i in range(na):
        predicts &= tau[i] == tau_found[i]
        tau_before[i] = tau[i]
    for i in range(nq):
        q_before[i] = q[i]
    for j in range(nv):
        v_before[j], v_dot_before[j] = v[j], v_dot[j]
    sums[PREDICTS] = 1.0 if predicts else 0.0
    return predicts


@compiled(NUMBER, ANY_MATRIX, VECTOR_OUT, ROWS_OUT, VECTOR_OUT, VECTOR_OUT)
def filter_residuals(time_constant: float, M: Array, sums: Array, vectors: Array, force: Array, torques: Array) -> None:
    """Filter the unexplained force and generalized force of a span, in place, and begin the next span.

    Args:
        time_constant: of the filter, s.
        M: joint-space inertia matrix, (nv, nv).
        sums: as of `follow`.
        vectors: as of `follow`.
        force: filtered, (3,) in N; (0,) for a fixed base, which the ground holds.
        torques: filtered, (nv,).
    """
    duration = sums[PREDICTED]
    if duration > 0.0:
        share = duration / (time_constant + duration)
        for i in range(len(force)):
            force[i] += share * (sums[IMPULSE + i] / duration - force[i])
        for j in range(len(torques)):
            torques[j] -= share * torques[j]
        for i in range(len(torques)):
            unexpected = share * vectors[0, i] / duration
            for j in range(len(torques)):
                torques[j] += M[j, i] * unexpected
    vectors[0, :] = 0.0
    for i in range(MOMENTUM):
        sums[i] = 0.0
