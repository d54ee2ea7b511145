"""Floating-base dynamics with constraints (section 4.2.2; S10)."""

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from wbc_controller.mechanics.checks import as_array
from wbc_controller.mechanics.constraints import Constraint, Kinematics, constraint_equation
from wbc_controller.mechanics.equations_of_motion import bias_force, mass_matrix
from wbc_controller.mechanics.gauss import ConstrainedMotion, gauss, gauss_unilateral
from wbc_controller.records import Array


def constrained_dynamics(
    model: pin.Model, q: Array, v: Array, force: Array, constraints: Sequence[Constraint] = (), *,
    unilateral: Sequence[Constraint] = (), t: float = 0.0, data: pin.Data | None = None,
) -> ConstrainedMotion:  # fmt: skip
    """Return the constrained motion (section 4.2.2, by (31) and (32); S10) with v̇ᵤ = M⁻¹(f - h), f = Sᵀτ + Jᵀw.

    Args:
        force: applied generalized force f, (nv,) in N and N·m.
        unilateral: constraints with λ ≥ 0, such as contacts that may detach.

    Raises:
        NoSolution: if the constraints are inconsistent.
    """
    data = data or model.createData()
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
    """Return the equality constraints E x = e of section 4.2.2, x = [v̇, τ, λ], for a quadratic program (S10).

    Args:
        h: bias force minus external generalized forces, (nv,).
        S: actuation matrix, (na, nv), see (34).

    Returns:
        E, (nv + k, nv + na + k), and e, (nv + k,): forces in N and N·m, then accelerations.
    """
    (k, nv), na = A.shape, len(S)
    E = np.zeros((nv + k, nv + na + k))
    E[:nv, :nv], E[:nv, nv : nv + na], E[:nv, nv + na :] = M, -S.T, -A.T
    E[nv:, :nv] = A
    return E, np.concatenate([-h, b])
