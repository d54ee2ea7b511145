"""Fourth-order integration on the configuration manifold.

q = q₀ ⊕ θ with θ̇ = D(θ)⁻¹ v and D = ∂(q₀ ⊕ θ)/∂θ, by Runge–Kutta steps in (θ, v) (Munthe-Kaas, "High order
Runge-Kutta methods on manifolds", 1999).
"""

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from wbc_controller.records import Array

Acceleration = Callable[[Array, Array, float], Array]  # v̇(q, v, t), t in s


def runge_kutta_step(
    model: pin.Model, acceleration: Acceleration, q: Array, v: Array, t: float, step: float
) -> tuple[Array, Array]:
    """Return q, (nq,), and v, (nv,), after one Runge–Kutta step, s, of the motion of (7) or (32)."""
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
