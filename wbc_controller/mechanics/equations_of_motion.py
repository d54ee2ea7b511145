"""The equations of motion M(q) v̇ + h(q, v) = Sᵀτ + Σ Jᵢᵀfᵢ: their terms, and forward and inverse dynamics (S1, S11).

Each function takes a `pinocchio.Model`, so that it also works for mechanisms outside the controller. All of them
compute in ``data`` if it is given, which saves its allocation, and return new arrays.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from wbc_controller.mechanics.checks import as_array, single_joint
from wbc_controller.records import Array


def mass_matrix(model: pin.Model, q: Array, *, data: pin.Data | None = None) -> Array:
    """Mass matrix M of equations (7), (22) and (34), (nv, nv), by the composite rigid body algorithm.

    The kinetic energy is T = ½ vᵀM v. M includes reflected rotor inertias (``model.armature``) and is symmetric
    positive definite; in kg, kg·m and kg·m², depending on the coordinates.
    """
    # Pinocchio's algorithm fills the upper triangle; its Python binding completes the matrix.
    return np.array(pin.crba(model, data if data is not None else model.createData(), q))


def bias_force(model: pin.Model, q: Array, v: Array, *, data: pin.Data | None = None) -> Array:
    """Bias force h of equation (34), (nv,) in N and N·m: Coriolis, centrifugal and gravity terms, h at v̇ = 0."""
    return np.array(pin.nonLinearEffects(model, data if data is not None else model.createData(), q, v))


def generalized_gravity(model: pin.Model, q: Array, *, data: pin.Data | None = None) -> Array:
    """Gradient of the potential energy, ∂V/∂q of equations (3) and (5): h at v = 0, (nv,) in N and N·m.

    The force of gravity is its negative.
    """
    return np.array(pin.computeGeneralizedGravity(model, data if data is not None else model.createData(), q))


def inverse_dynamics(model: pin.Model, q: Array, v: Array, v_dot: Array, *, data: pin.Data | None = None) -> Array:
    """Generalized force that causes an acceleration, M v̇ + h, (nv,) in N and N·m (section 1.2, equation (22); S11).

    It is Sᵀτ plus all external and constraint forces. Pinocchio's recursive Newton–Euler algorithm (Luh, Walker, Paul,
    "On-line computational scheme for mechanical manipulators", 1980) does not form M.
    """
    return np.array(pin.rnea(model, data if data is not None else model.createData(), q, v, v_dot))


def forward_dynamics(model: pin.Model, q: Array, v: Array, force: Array, *, data: pin.Data | None = None) -> Array:
    """Unconstrained acceleration v̇ᵤ = M⁻¹(f - h) of section 4.2.2, (nv,) in m/s² and rad/s² (S11).

    Pinocchio's articulated body algorithm (Featherstone, "Rigid Body Dynamics Algorithms", 2008).

    Args:
        force: generalized force f = Sᵀτ + Jᵀw, (nv,) in N and N·m.
    """
    return np.array(pin.aba(model, data if data is not None else model.createData(), q, v, force))


def actuation_matrix(model: pin.Model, joints: Sequence[str]) -> Array:
    """Actuation matrix S of equation (34): the generalized force of the joint torques is Sᵀτ.

    The note writes Sτ, with the transpose of this matrix.

    Args:
        joints: actuated joints with one degree of freedom, in the order of τ.

    Returns:
        S, (na, nv), of zeros and ones, without units: τ in N·m (N for a prismatic joint).

    Raises:
        ConfigurationError: where a joint is unknown, or has more or less than one degree of freedom.
    """
    S = np.zeros((len(joints), model.nv))
    for row, name in enumerate(joints):
        S[row, single_joint(model, name).idx_v] = 1.0
    return S


def equations_of_motion_residual(
    M: Array, h: Array, v_dot: Array, force: npt.ArrayLike, constraint_force: npt.ArrayLike
) -> Array:
    """Residual of a motion in the equations of section 4.2.2: M v̇ + h - Sᵀτ - Aᵀλ, zero for a physical motion.

    Args:
        force: applied generalized force Sᵀτ + Jᵀw, (nv,) in N and N·m.
        constraint_force: f_c = Aᵀλ, (nv,) in N and N·m.

    Raises:
        InputRefused: if a force has another shape, or is not finite.
    """
    n = len(h)
    applied, constraint = as_array("force", force, (n,)), as_array("constraint_force", constraint_force, (n,))
    return np.asarray(M @ v_dot + h - applied - constraint)
