"""M(q) v̇ + h(q, v) = Sᵀτ + Σ Jᵢᵀfᵢ: forward and inverse dynamics, and integration (S1, S11)."""

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from wbc_controller.mechanics.checks import as_array, single_joint
from wbc_controller.records import Array

Acceleration = Callable[[Array, Array, float], Array]  # v̇(q, v, t), t in s


def mass_matrix(model: pin.Model, q: Array, *, data: pin.Data | None = None) -> Array:
    """Return the mass matrix M of equations (7), (22) and (34), (nv, nv), in kg, kg·m and kg·m².

    Composite rigid body algorithm, with reflected rotor inertias (``model.armature``).
    """
    return np.array(pin.crba(model, data or model.createData(), q))


def bias_force(model: pin.Model, q: Array, v: Array, *, data: pin.Data | None = None) -> Array:
    """Return the bias force h of equation (34), (nv,) in N and N·m: Coriolis, centrifugal and gravity terms."""
    return np.array(pin.nonLinearEffects(model, data or model.createData(), q, v))


def generalized_gravity(model: pin.Model, q: Array, *, data: pin.Data | None = None) -> Array:
    """Return the gradient of the potential energy, ∂V/∂q of equations (3) and (5), (nv,) in N and N·m: h at v = 0."""
    return np.array(pin.computeGeneralizedGravity(model, data or model.createData(), q))


def inverse_dynamics(model: pin.Model, q: Array, v: Array, v_dot: Array, *, data: pin.Data | None = None) -> Array:
    """Return the total generalized force M v̇ + h, (nv,) in N and N·m (section 1.2, equation (22); S11).

    Recursive Newton–Euler algorithm (Luh, Walker, Paul, "On-line computational scheme for mechanical manipulators",
    1980).
    """
    return np.array(pin.rnea(model, data or model.createData(), q, v, v_dot))


def forward_dynamics(model: pin.Model, q: Array, v: Array, force: Array, *, data: pin.Data | None = None) -> Array:
    """Return the unconstrained acceleration v̇ᵤ = M⁻¹(f - h) of section 4.2.2, (nv,) in m/s² and rad/s² (S11).

    Articulated body algorithm (Featherstone, "Rigid Body Dynamics Algorithms", 2008).
    """
    return np.array(pin.aba(model, data or model.createData(), q, v, force))


def actuation_matrix(model: pin.Model, joints: Sequence[str]) -> Array:
    """Return the actuation matrix S of equation (34), (na, nv), with generalized force Sᵀτ (the note: Sτ), τ in N·m.

    Args:
        joints: actuated joints with one degree of freedom, in the order of τ.

    Raises:
        ConfigurationError: if a joint is unknown, or does not have one degree of freedom.
    """
    S = np.zeros((len(joints), model.nv))
    for row, name in enumerate(joints):
        S[row, single_joint(model, name).idx_v] = 1.0
    return S


def equations_of_motion_residual(
    M: Array, h: Array, v_dot: Array, force: npt.ArrayLike, constraint_force: npt.ArrayLike
) -> Array:
    """Return the residual M v̇ + h - f - f_c of section 4.2.2, (nv,) in N and N·m.

    Args:
        force: applied generalized force f = Sᵀτ + Jᵀw, (nv,).
        constraint_force: f_c = Aᵀλ, (nv,).

    Raises:
        InputRefused: if a force is invalid.
    """
    n = len(h)
    applied, constraint = as_array("force", force, (n,)), as_array("constraint_force", constraint_force, (n,))
    return np.asarray(M @ v_dot + h - applied - constraint)


def runge_kutta_step(
    model: pin.Model, acceleration: Acceleration, q: Array, v: Array, t: float, step: float
) -> tuple[Array, Array]:
    """Return q, (nq,), and v, (nv,), after one Runge–Kutta step, s, of the motion of (7) or (32).

    Fourth order on the configuration manifold: q = q₀ ⊕ θ with θ̇ = D(θ)⁻¹ v and D = ∂(q₀ ⊕ θ)/∂θ, by steps in (θ, v)
    (Munthe-Kaas, "High order Runge-Kutta methods on manifolds", 1999).
    """
    curved = model.nq != model.nv  # otherwise D is the identity

    def rates(theta: Array, v_now: Array, t_now: float) -> tuple[Array, Array]:
        q_now = pin.integrate(model, q, theta)
        theta_rate = v_now
        if curved:
            theta_rate = np.linalg.solve(pin.dIntegrate(model, q, theta, pin.ARG1), v_now)
        return theta_rate, acceleration(q_now, v_now, t_now)

    half = 0.5 * step
    d1, a1 = v, acceleration(q, v, t)
    d2, a2 = rates(half * d1, v + half * a1, t + half)
    d3, a3 = rates(half * d2, v + half * a2, t + half)
    d4, a4 = rates(step * d3, v + step * a3, t + step)
    theta = step / 6.0 * (d1 + 2.0 * d2 + 2.0 * d3 + d4)
    return np.array(pin.integrate(model, q, theta)), v + step / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)


def simulate(
    model: pin.Model, acceleration: Acceleration, q: Array, v: Array, step: float, steps: int
) -> tuple[Array, Array]:
    """Integrate the motion of (7) or (32); return q, (k + 1, nq), and v, (k + 1, nv) in m/s and rad/s, for k steps."""
    qs, vs = np.empty((steps + 1, model.nq)), np.empty((steps + 1, model.nv))
    qs[0], vs[0] = q, v
    for k in range(steps):
        qs[k + 1], vs[k + 1] = runge_kutta_step(model, acceleration, qs[k], vs[k], k * step, step)
    return qs, vs
