"""Redundant contacts: the rows of J v̇ = b that depend on others, or nearly so, become part of the cost.

Feet without ankle roll, legs without hip abduction or four points under one sole hold more directions than the robot
can move along. Rounding, a velocity of the contacts (d/dt of nᵀJ = 0 is nᵀJ̇ v = -ṅᵀJ v) or their anchors make such
rows contradict each other, so they cannot all be constraints. The mobility of the contacts, the inverse of their
operational-space inertia (Khatib, "A unified approach for motion and force control of robot manipulators", 1987), shows
them independently of the coordinates (S2). With the metric W of the contact forces, and joints that follow others,

    Λ⁻¹ = W^-½ J (M⁻¹ - M⁻¹Cᵀ (C M⁻¹Cᵀ)⁻¹ C M⁻¹) Jᵀ W^-½ = Σ μᵢ uᵢ uᵢᵀ

a unit force along uᵢ accelerates the contacts along uᵢ by μᵢ: 1/μᵢ is an apparent mass. With the robot's mass m,
directions with ρᵢ = m μᵢ / LEAST < 1 are redundant. J v̇ = b holds along the others, and along these the cost has

    ½ Σ wᵢ (uᵢᵀ W^-½ (J v̇ - b))²,    wᵢ = WEIGHT ρᵢ / (1 - ρᵢ)

so that their motion is a least-squares solution. wᵢ grows from 0 without bound: nothing jumps as a direction becomes a
constraint.
"""

import numpy as np

from wbc_controller.inverse_dynamics.method_calls import is_finite
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.records import Array

#: Smallest mobility of a constraint, as a share of that of a free body of the robot's mass. Shipped robots have 1.3 or
#: more near their stances, and 0.2 with straight knees.
LEAST = 0.01
#: Mobility below which a set of contacts may become redundant, and is examined in every cycle.
NEARLY = 0.1
#: Weight of a redundant direction with ρ = ½, (m/s²)⁻²; and the largest ρ / (1 - ρ).
WEIGHT, _LARGEST = 1.0e4, 1.0e4


def mobilities(J: Array, metric: Array, dynamics: Dynamics) -> tuple[Array, Array]:
    """Return m μ in ascending order, (nf,), and the directions u as columns, (nf, nf); inf for a state with NaN.

    Args:
        J: stacked Jacobians of the active contacts, (nf, nv).
        metric: diagonal of W, (nf,).
        dynamics: the snapshot, at the state of J.
    """
    k, C = len(J), dynamics.model.actuation.C
    if not (is_finite(J) and is_finite(dynamics.M)):  # the solver refuses such a problem
        return np.full(k, np.inf), np.eye(k)
    rows = np.vstack([J / np.sqrt(metric)[:, None], C])
    mobility = rows @ np.linalg.solve(dynamics.M, rows.T)
    own, across = mobility[:k, :k], mobility[:k, k:]
    if len(C):
        own = own - across @ np.linalg.solve(mobility[k:, k:], across.T)
    values, directions = np.linalg.eigh(dynamics.model.mass * 0.5 * (own + own.T))
    return values, directions


def separate(J: Array, b: Array, metric: Array, dynamics: Dynamics) -> tuple[Array, Array]:
    """Separate J v̇ = b into constraints and rows of the cost.

    Returns:
        Rows [J, b] of the constraints, which may depend on each other but do not contradict each other, and rows of the
        cost with weight 1; both (nf, nv + 1).
    """
    rows = np.column_stack([J, b])
    values, directions = mobilities(J, metric, dynamics)
    share = np.clip(values / LEAST, 0.0, None)
    redundant = share < 1.0
    u, share = directions[:, redundant], share[redundant]
    scale = np.sqrt(metric)[:, None]
    along = u.T @ (rows / scale)
    soft = np.zeros_like(rows)
    soft[: len(along)] = np.sqrt(WEIGHT * np.minimum(share / (1.0 - share), _LARGEST))[:, None] * along
    return (rows - scale * (u @ along) if len(along) else rows), soft
