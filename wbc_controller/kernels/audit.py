"""The balances of energy, momentum and joint torques between two states (`diagnostics.audit`)."""

from __future__ import annotations

from wbc_controller.kernels.compiled import (
    ANY_MATRIX,
    ANY_VECTOR,
    NUMBER,
    ROWS,
    VECTOR,
    VECTOR_OUT,
    compiled,
)
from wbc_controller.records import Array


@compiled(ANY_MATRIX, ANY_VECTOR, VECTOR, VECTOR, NUMBER, ANY_VECTOR, ANY_VECTOR, ANY_MATRIX, ANY_VECTOR, VECTOR_OUT)
def mechanical_state(
    M: Array, v: Array, v_dot: Array, gravity: Array, mass: float, com: Array, com_velocity: Array, com_jacobian: Array,
    com_drift: Array, out: Array,
) -> float:  # fmt: skip
    """The energy T + V = ½ vᵀM v - m gᵀc, and into `out` the momentum m ċ and the force m c̈ = m (J v̇ + δ).

    Args:
        M: joint-space inertia matrix, (nv, nv).
        v: generalized velocity, (nv,).
        v_dot: generalized acceleration, (nv,).
        gravity: weight m g, (3,) in N.
        mass: m, kg.
        com: centre of mass c, (3,) in m.
        com_velocity: ċ, (3,) in m/s.
        com_jacobian: J, (3, nv).
        com_drift: δ = c̈ at v̇ = 0, (3,) in m/s².
        out: for the momentum in N·s and the force in N, (6,).

    Returns:
        The energy, J.
    """
    energy = 0.0
    for j in range(len(v)):
        momentum = 0.0
        for i in range(len(v)):
            momentum += M[i, j] * v[i]
        energy += 0.5 * momentum * v[j]
    for i in range(3):
        acceleration = com_drift[i]
        for j in range(len(v)):
            acceleration += com_jacobian[i, j] * v_dot[j]
        energy -= gravity[i] * com[i]
        out[i], out[3 + i] = mass * com_velocity[i], mass * acceleration
    return energy


@compiled(VECTOR, ROWS, VECTOR, VECTOR, NUMBER)
def joint_powers(tau: Array, S: Array, passive: Array, moved: Array, gap: float) -> tuple[float, float]:
    """Power of the torques and of passive joints over a motion, and the sum of its absolute values, W.

    Args:
        tau: torques, (na,) in N·m.
        S: actuation matrix, (na, nv).
        passive: generalized force of passive joints, (nv,); (0,) where there are none.
        moved: change of the configuration, (nv,).
        gap: its time, s.
    """
    supplied, throughput = 0.0, 0.0
    for j in range(len(moved)):
        force = passive[j] if len(passive) else 0.0
        for i in range(len(tau)):
            force += tau[i] * S[i, j]
        power = force * moved[j] / gap
        supplied += power
        throughput += abs(power)
    return supplied, throughput


@compiled(NUMBER, NUMBER, ANY_MATRIX, ANY_VECTOR, ANY_VECTOR, VECTOR, VECTOR, VECTOR, VECTOR_OUT, VECTOR_OUT)
def filter_residuals(
    share: float, gap: float, M: Array, v_before: Array, v_after: Array, v_dot: Array, before: Array, after: Array,
    force: Array, torques: Array,
) -> None:  # fmt: skip
    """Filter the unexplained force Δ(m ċ) / Δt - m c̈ and generalized force M (Δv / Δt - v̇), in place.

    Args:
        share: of the new value in the filtered one.
        gap: Δt, s.
        M: joint-space inertia matrix, (nv, nv).
        v_before: generalized velocity before, (nv,).
        v_after: generalized velocity after, (nv,).
        v_dot: v̇ as it was predicted, (nv,).
        before: momentum and predicted force before, (6,).
        after: momentum and predicted force after, (6,).
        force: filtered, (3,) in N; (0,) for a fixed base, which the ground holds.
        torques: filtered, (nv,).
    """
    for i in range(len(force)):
        force[i] += share * ((after[i] - before[i]) / gap - before[3 + i] - force[i])
    for j in range(len(torques)):
        torques[j] -= share * torques[j]
    for i in range(len(torques)):
        unexpected = share * ((v_after[i] - v_before[i]) / gap - v_dot[i])
        for j in range(len(torques)):
            torques[j] += M[j, i] * unexpected
