"""Floating-base dynamics under constraints, M v̇ + h = Sᵀτ + Aᵀλ and A v̇ = b (section 4.2.2; S10).

As forward dynamics for given torques, and as the equality constraints of a quadratic program that chooses the torques.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from wbc_controller.mechanics.checks import as_array
from wbc_controller.mechanics.constraints import Constraint, Kinematics, constraint_equation
from wbc_controller.mechanics.equations_of_motion import bias_force, mass_matrix
from wbc_controller.mechanics.gauss import ConstrainedMotion, gauss, gauss_unilateral
from wbc_controller.records import Array


def constrained_dynamics(
    model: pin.Model,
    q: Array,
    v: Array,
    force: Array,
    constraints: Sequence[Constraint] = (),
    *,
    unilateral: Sequence[Constraint] = (),
    t: float = 0.0,
    data: pin.Data | None = None,
) -> ConstrainedMotion:
    """Acceleration under constraints, given the applied forces (section 4.2.2, through (31) and (32); S10).

    The unconstrained acceleration is v̇ᵤ = M⁻¹(f - h), with f = Sᵀτ + Jᵀw. The multipliers are in the order of the
    constraints.

    Args:
        force: applied generalized force, (nv,) in N and N·m.
        constraints: bilateral constraints; they may be redundant.
        unilateral: unilateral constraints, with λ ≥ 0, such as contacts; those whose λ would be negative detach.

    Raises:
        ConfigurationError: if the model has no such frame or joint.
        InputRefused: if the force has another shape, or is not finite.
        NoSolution: if the constraints contradict each other.
    """
    data = data if data is not None else model.createData()
    f = as_array("force", force, (model.nv,))
    M = mass_matrix(model, q, data=data)
    v_dot_u = np.asarray(np.linalg.solve(M, f - bias_force(model, q, v, data=data)), dtype=np.float64)
    kinematics = Kinematics(model, q, v, t, data=data)
    both = constraint_equation(constraints, kinematics)
    if not unilateral:
        return gauss(M, v_dot_u, both.A, both.b)
    one = constraint_equation(unilateral, kinematics)
    return gauss_unilateral(M, v_dot_u, both.A, both.b, one.A, one.b)


def contact_dynamics_equations(M: Array, h: Array, S: Array, A: Array, b: Array) -> tuple[Array, Array]:
    """Section 4.2.2 as equality constraints E x = e with x = [v̇, τ, λ], for a program that chooses the torques (S10).

    Args:
        h: bias force less external generalized forces, (nv,).
        S: actuation matrix, (na, nv); the generalized force of the torques is Sᵀτ (34).
        b: right-hand side of (30), (k,) in m/s² and rad/s².

    Returns:
        E, (nv + k, nv + na + k), and e, (nv + k,): rows of forces in N and N·m, then rows of accelerations.
    """
    (k, nv), na = A.shape, len(S)
    E = np.zeros((nv + k, nv + na + k))
    E[:nv, :nv], E[:nv, nv : nv + na], E[:nv, nv + na :] = M, -S.T, -A.T
    E[nv:, :nv] = A
    return E, np.concatenate([-h, b])
