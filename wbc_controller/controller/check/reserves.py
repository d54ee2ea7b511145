"""How far a standing robot could be pushed, sway and squat: linear programs over contact forces and torques at rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.linalg import block_diag
from scipy.optimize import linprog

from wbc_controller.controller.check.finding import Finding
from wbc_controller.inverse_dynamics.contacts import AnchoredContact, Contact
from wbc_controller.inverse_dynamics.whole_body_qp import WholeBodyQP
from wbc_controller.records import Array

#: The four directions, in the axes of an upright base.
_DIRECTIONS = {"forward": (1.0, 0.0, 0.0), "back": (-1.0, 0.0, 0.0), "left": (0.0, 1.0, 0.0), "right": (0.0, -1.0, 0.0)}
#: Share by which the multiple has to grow, per share of an effort limit, for the limit to count as what bounds it.
_MATTERS = 1.0e-3
#: Step of a motion of the centre of mass, m, and the largest share of its height that is tried for a squat.
_STEP, _DEEPEST = 0.01, 0.6
#: Smallest step that is tried, m.
_LEAST_STEP = 1.0e-6
#: Iterations of Newton's method in each step, and the largest error that is left, m and rad.
_ITERATIONS, _REACHED = 6, 1.0e-3
#: Weight of the joints' own motion: of all ways down the one that moves them least.
_LEAST_MOTION = 1.0e-3


@dataclass(frozen=True, slots=True)
class _Balance:
    """The largest multiple of a disturbance, and the actuator that allows no more; None where it is the contacts."""

    most: float
    actuator: str | None


def reserves(
    qp: WholeBodyQP, active: Sequence[str], q: Array, hanging: Sequence[int], margin: float = 0.0
) -> list[Finding]:
    """Find the reserves of a robot with a floating base that stands in a configuration q, where its dynamics are left.

    A push is a steady horizontal force on the base, in line with the centre of mass. Swaying moves the weight
    sideways, at the posture's own torque arms. Friction, supports, largest forces and effort limits hold. `hanging` are
    indices of joints without a motor that nothing supports; `margin` is the distance from the position limits, rad.
    """
    model, dynamics = qp.model, qp.dynamics
    bearing = [contact for name, contact in qp.contacts.items() if name in active or contact.permanent]
    arm = dynamics.com - dynamics.placement(model.frame_id(model.base_link, "base")).translation
    weight = model.mass * np.array(model.pinocchio.gravity.linear)
    pushes, shifts = {}, {}
    for name, direction in _DIRECTIONS.items():
        way = np.array(direction)
        pushes[name] = _most(qp, bearing, hanging, np.concatenate([way, np.cross(arm, way)]))
        shifts[name] = _most(qp, bearing, hanging, np.concatenate([np.zeros(3), np.cross(way, weight)]))
    found = [
        Finding("push", "steady, at the centre of mass: " + _listed(pushes, 1.0, "N")),
        Finding("sway", "of the centre of mass: " + _listed(shifts, 1e3, "mm")),
    ]
    squat = com_reach(qp, active, q, hanging, -np.eye(3)[2], _DEEPEST * float(dynamics.com[2]), margin)
    if squat is not None:
        found.append(Finding("squat", f"{1e3 * squat.distance:.0f} mm straight down; {squat.why}"))
    return found


def _listed(found: dict[str, _Balance], scale: float, unit: str) -> str:
    parts = []
    for name, balance in found.items():
        size = f"{scale * balance.most:.0f} {unit}" if np.isfinite(balance.most) else "any"
        parts.append(f"{size} {name}" + (f" ({balance.actuator})" if balance.actuator else ""))
    return ", ".join(parts)


def _most(qp: WholeBodyQP, bearing: Sequence[Contact], hanging: Sequence[int], wrench: Array) -> _Balance:
    """The largest multiple of a wrench on the base, about its origin in world axes, (6,), that can be borne at rest.

    With S and C of `Actuation`, over contact forces f, torques τ, forces of followers λ and the multiple s:

        maximize s    subject to    Jᵀf + Sᵀτ + Cᵀλ + s J_baseᵀ w = h,    cones and bounds of f,    |τ| ≤ τ_max.
    """
    model, dynamics = qp.model, qp.dynamics
    base = dynamics.jacobian(model.frame_id(model.base_link, "base"), pin.LOCAL_WORLD_ALIGNED)
    J = np.vstack([np.zeros((0, model.nv)), *(contact.jacobian(dynamics) for contact in bearing)])
    blocks = [J.T, model.actuation.S.T, model.actuation.C.T, (base.T @ wrench)[:, None]]
    rows = np.delete(np.arange(model.nv), model.v_index[list(hanging)])
    cone = block_diag(*(contact.cone for contact in bearing))
    width = sum(block.shape[1] for block in blocks)
    bounds = [pair for contact in bearing for pair in zip(*contact.bounds(1.0), strict=True)]
    bounds += [(-limit, limit) for limit in model.effort_limits]
    bounds += [(-np.inf, np.inf)] * len(model.actuation.C) + [(0.0, np.inf)]
    result = linprog(
        -np.eye(width)[-1],
        A_ub=np.hstack([cone, np.zeros((len(cone), width - cone.shape[1]))]),
        b_ub=np.zeros(len(cone)),
        A_eq=np.hstack(blocks)[rows],
        b_eq=dynamics.h[rows],
        bounds=bounds,
        method="highs",
    )
    if result.status == 3:
        return _Balance(np.inf, None)
    if result.x is None:
        return _Balance(0.0, None)
    most, torques = float(result.x[-1]), slice(len(J), len(J) + model.na)
    # Many torques bear the same load; only where the multiplier of a limit is not zero does it bound the multiple.
    worth = (np.abs(result.lower.marginals) + np.abs(result.upper.marginals))[torques] * model.effort_limits
    worst = int(np.argmax(worth))
    return _Balance(most, model.actuators[worst] if worth[worst] > _MATTERS * most else None)


@dataclass(frozen=True, slots=True)
class ComReach:
    """The distance that the centre of mass can move, m, and the reason for its end."""

    distance: float
    why: str


def com_reach(
    qp: WholeBodyQP,
    active: Sequence[str],
    q: Array,
    hanging: Sequence[int],
    direction: Array,
    most: float,
    margin: float = 0.0,
) -> ComReach | None:
    """Find how far the centre of mass can move at rest, with the base level and the contacts in place.

    Args:
        q: configuration at the start, in which the dynamics are left.
        hanging: indices of joints without a motor that nothing supports.
        direction: unit vector in the world, (3,).
        most: largest distance that is tried, m.
        margin: distance from the position limits, rad.

    Returns:
        The distance; None if a loop is closed, as its opening along the way is not known.
    """
    model, dynamics = qp.model, qp.dynamics
    bearing = [contact for name, contact in qp.contacts.items() if name in active or contact.permanent]
    anchored = [contact for contact in bearing if isinstance(contact, AnchoredContact)]
    if len(anchored) < len(bearing):
        return None
    base, start = model.frame_id(model.base_link, "base"), dynamics.com.copy()
    upright = dynamics.placement(base).rotation.copy()
    held = [(contact, contact.anchor(dynamics)) for contact in anchored]
    lower, upper = model.position_lower + margin, model.position_upper - margin
    begin = q[model.q_index]
    lower, upper = np.minimum(lower, begin), np.maximum(upper, begin)  # the posture itself may be nearer
    distance, why, at = 0.0, "", np.array(q)
    while not why:
        step = min(_STEP, most - distance)
        goal = start + (distance + step) * direction
        if not (step > _LEAST_STEP):
            why = "no more was tried"
            break
        for _ in range(_ITERATIONS):
            dynamics.update(at, np.zeros(model.nv))
            turned = pin.log3(upright @ dynamics.placement(base).rotation.T)
            J = np.vstack(
                [
                    *(contact.jacobian(dynamics) for contact, _ in held),
                    dynamics.com_jacobian,
                    dynamics.jacobian(base, pin.LOCAL_WORLD_ALIGNED)[3:],
                    model.actuation.C,
                ]
            )
            error = np.concatenate(
                [
                    *(contact.displacement(dynamics, anchor) for contact, anchor in held),
                    goal - dynamics.com,
                    turned,
                    np.zeros(len(model.actuation.C)),
                ]
            )
            least = _LEAST_MOTION * np.eye(model.nv)
            change = np.linalg.lstsq(np.vstack([J, least]), np.concatenate([error, np.zeros(model.nv)]), rcond=None)[0]
            at = np.asarray(pin.integrate(model.pinocchio, at, change))
        joints = at[model.q_index]
        beyond = np.flatnonzero((joints < lower) | (joints > upper))
        if np.abs(error).max() > _REACHED:
            why = "the legs reach no further"
        elif beyond.size:
            why = f"{model.joints[beyond[0]]} is at its position limit"
        elif not _stands(qp, anchored, hanging):
            why = "the torques or contacts bear no more"
        else:
            distance += step
    dynamics.update(q, np.zeros(model.nv))
    return ComReach(distance, why)


def _stands(qp: WholeBodyQP, bearing: Sequence[Contact], hanging: Sequence[int]) -> bool:
    """Whether the weight can be borne at rest."""
    return _most(qp, bearing, hanging, np.zeros(6)).most > 0.0
