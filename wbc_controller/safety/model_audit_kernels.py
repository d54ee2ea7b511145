"""The balances of energy, momentum and joint torques over a span of states (`safety.model_audit`)."""

from __future__ import annotations

import math

import numpy as np

from wbc_controller.compiled import (
    ANY_VECTOR,
    NUMBER,
    TABLE,
    VECTOR,
    VECTOR_OUT,
    as_part,
    compile_all,
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


@compiled(TABLE, VECTOR)
def mechanical_energy(table: np.ndarray, v: Array) -> float:
    """The energy T + V = ½ vᵀM v - m gᵀc, J.

    Args:
        table: of `look_back`.
        v: generalized velocity, (nv,).
    """
    nv = table[0]
    if len(v) != nv:
        raise ValueError("mechanical_energy: v has another size than the model's")
    M, com, weight = matrix(table, 4, nv, nv), vector(table, 5, 3), vector(table, 6, 3)
    energy = 0.0
    for j in range(nv):
        momentum = 0.0
        for i in range(nv):
            momentum += M[j, i] * v[i]
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
    actuators, moved_by, ratios = indices(table, 4, entries), indices(table, 5, entries), vector(table, 6, entries)
    mass, com_velocity, com_drift = vector(table, 7, 1)[0], vector(table, 8, 3), vector(table, 10, 3)
    com_jacobian, sums, vectors = matrix(table, 9, nv, 6), vector(table, 11, SUMS), matrix(table, 12, 2, nv)
    before = vector(table, 13, nq + 2 * nv + na)
    if not (len(q) == nq and len(v) == nv and len(v_dot) == nv and len(tau) == na and len(tau_found) == na):
        raise ValueError("follow: state, accelerations or torques have another size than the model's")
    if not ((len(beside) == nv or len(beside) == 0) and (len(moved) == nv or len(moved) == 0)):
        raise ValueError("follow: beside or moved has another size than v")
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


_mechanical_energy = as_part(mechanical_energy)


@compiled(TABLE, NUMBER, VECTOR, NUMBER, NUMBER, NUMBER, VECTOR_OUT)
def look_back(
    table: np.ndarray, lasted: float, v: Array, stored: float, energy: float, throughput: float, found: Array
) -> tuple[float, float, float, float, float, int]:  # fmt: skip
    """Put a span through the filter, and begin the next one.

    Args:
        table: nv, the number of joints nj, that k of pairs of a component and a joint, and the size of the force, 3, or
            0 for a fixed base, which the ground holds; and, in this order,
            M: joint-space inertia matrix at this state, (nv, nv), symmetric.
            com: centre of mass c at this state, (3,) in m.
            weight: m g, (3,) in N.
            components: of a generalized force, of each pair, (k,).
            joints: to which this component counts, (k,).
            factors: by which, (k,).
            limits: largest unexplained torque of each joint, (nj,) in N·m.
            sums: as of `follow`.
            vectors: as of `follow`.
            force: filtered, in N.
            torques: filtered generalized force, (nv,).
            time_constant: of the filter, (1,) in s.
        lasted: duration of the span, s.
        v: generalized velocity, (nv,).
        stored: energy at the start of the span, J.
        energy: filtered energy residual, W.
        throughput: filtered power of the joints, W.
        found: for the filtered force, (3,), and then the torque of each joint, (nj,).

    Returns:
        The energy at this state, the filtered energy residual and power, the size of the force, and the largest torque
        as a share of its limit, with its joint.
    """
    nv, nj, pairs, held = table[0], table[1], table[2], table[3]
    M, sums, vectors = matrix(table, 4, nv, nv), vector(table, 11, SUMS), matrix(table, 12, 2, nv)
    components, joints = indices(table, 7, pairs), indices(table, 8, pairs)
    factors, limits = vector(table, 9, pairs), vector(table, 10, nj)
    force, torques, time_constant = vector(table, 13, held), vector(table, 14, nv), vector(table, 15, 1)[0]
    if len(found) != 3 + nj:
        raise ValueError("look_back: found has another size than the force and the joints")
    share = lasted / (time_constant + lasted)
    now = _mechanical_energy(table, v)
    energy += share * ((now - stored - sums[WORK]) / lasted - energy)
    throughput += share * (sums[THROUGHPUT] / lasted - throughput)
    duration = sums[PREDICTED]
    if duration > 0.0:
        share = duration / (time_constant + duration)
        for i in range(held):
            force[i] += share * (sums[IMPULSE + i] / duration - force[i])
        for j in range(nv):
            torques[j] -= share * torques[j]
        for i in range(nv):
            unexpected = share * vectors[0, i] / duration
            for j in range(nv):
                torques[j] += M[i, j] * unexpected
    vectors[0, :] = 0.0
    for i in range(MOMENTUM):
        sums[i] = 0.0
    found[:] = 0.0
    size = 0.0
    for i in range(held):
        found[i] = force[i]
        size += force[i] * force[i]
    for k in range(pairs):
        found[3 + joints[k]] += factors[k] * torques[components[k]]
    most, worst = -1.0, 0
    for i in range(nj):
        over = abs(found[3 + i]) / limits[i]
        if over > most:
            most, worst = over, i
    return now, energy, throughput, math.sqrt(size), most, worst


compile_all()
