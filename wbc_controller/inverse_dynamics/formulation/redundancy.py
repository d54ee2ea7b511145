"""Redundant contacts: dependent rows become part of the cost.

Such rows (examples: docs/contacts.md) become contradictory by rounding, contact velocities (nᵀJ̇ v = -ṅᵀJ v) or anchors.
The mobility of the contacts determines them independently of the coordinates (S2). It is the inverse of their
operational-space inertia (Khatib, IEEE Journal on Robotics and Automation, 1987). With the metric W of the contact
forces, and mimic joints,

    Λ⁻¹ = W^-½ J (M⁻¹ - M⁻¹Cᵀ (C M⁻¹Cᵀ)⁻¹ C M⁻¹) Jᵀ W^-½ = Σ μᵢ uᵢ uᵢᵀ

a unit force along uᵢ accelerates the contacts along uᵢ by μᵢ. With the robot's mass m, directions with ρᵢ = m μᵢ /
`LEAST_MOBILITY` < 1 are redundant. J v̇ = b holds along the others. Along redundant ones the cost has

    ½ Σ wᵢ (uᵢᵀ W^-½ (J v̇ - b))²,    wᵢ = `REDUNDANT_WEIGHT` ρᵢ / (1 - ρᵢ)

wᵢ grows continuously from 0, until the direction is a constraint.
"""

import numpy as np

from wbc_controller.inverse_dynamics.method_calls import is_finite
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.records import Array

#: Relative to a free body of the robot's mass; shipped robots have 1.3 near their stances, 0.2 with straight knees.
LEAST_MOBILITY = 0.01
EXAMINED_MOBILITY = 0.1  # for separation in every cycle
EXAMINED_MOTION = 0.05  # joint motion until the next examination, rad or m
REDUNDANT_WEIGHT, _LARGEST = 1.0e4, 1.0e4  # for ρ = ½, (m/s²)⁻²; largest ρ / (1 - ρ)


def mobilities(J: Array, metric: Array, dynamics: Dynamics) -> tuple[Array, Array]:
    """Return m μ in ascending order, (nf,), inf for NaN, and the directions u as columns, (nf, nf)."""
    k, C = len(J), dynamics.model.actuation.C
    if not (is_finite(J) and is_finite(dynamics.M)):  # refused by the solver
        return np.full(k, np.inf), np.eye(k)
    rows = np.vstack([J / np.sqrt(metric)[:, None], C])
    mobility = rows @ np.linalg.solve(dynamics.M, rows.T)
    own, across = mobility[:k, :k], mobility[:k, k:]
    if len(C):
        own = own - across @ np.linalg.solve(mobility[k:, k:], across.T)
    values, directions = np.linalg.eigh(dynamics.model.mass * 0.5 * (own + own.T))
    return values, directions


def separate_redundant_rows(J: Array, b: Array, metric: Array, dynamics: Dynamics) -> tuple[Array, Array]:
    """Return rows [J, b] of consistent constraints, and rows of the cost with weight 1, both (nf, nv + 1)."""
    rows = np.column_stack([J, b])
    values, directions = mobilities(J, metric, dynamics)
    share = np.clip(values / LEAST_MOBILITY, 0.0, None)
    redundant = share < 1.0
    u, share = directions[:, redundant], share[redundant]
    scale = np.sqrt(metric)[:, None]
    along = u.T @ (rows / scale)
    soft = np.zeros_like(rows)
    soft[: len(along)] = np.sqrt(REDUNDANT_WEIGHT * np.minimum(share / (1.0 - share), _LARGEST))[:, None] * along
    return (rows - scale * (u @ along) if len(along) else rows), soft
