"""Reserves of a standing robot: largest push, sway and squat."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.linalg import block_diag
from scipy.optimize import linprog

from wbc_controller.controller.check import Finding
from wbc_controller.inverse_dynamics.contacts import AnchoredContact, Contact
from wbc_controller.inverse_dynamics.whole_body_qp import WholeBodyQP
from wbc_controller.records import Array

#: Directions in the axes of an upright base.
_DIRECTIONS = {"forward": (1.0, 0.0, 0.0), "back": (-1.0, 0.0, 0.0), "left": (0.0, 1.0, 0.0), "right": (0.0, -1.0, 0.0)}
_MATTERS = 1.0e-3  # smallest relative sensitivity to an effort limit that counts as the cause
_STEP, _DEEPEST = 0.01, 0.6  # step of a squat, m, and deepest one as a share of the centre of mass' height
#: Newton iterations per step, largest error, m and rad, and largest contact error (`formulation.redundancy`).
_ITERATIONS, _REACHED, _HELD = 6, 1.0e-3, 5.0e-4
_STEPS, _HALVINGS = 3, 7  # steps to the static sway, and halvings of the last one
_FREE = 0.01  # weight of the height, and of an uncontrolled base orientation, in a sway
_LEAST_MOTION = 1.0e-3  # weight of joint motion


@dataclass(frozen=True, slots=True)
class Reserve:
    """Largest multiple of a load, or distance, m, and the limiting cause; None for the contacts."""

    most: float
    cause: str | None


def reserves(
    qp: WholeBodyQP, active: Sequence[str], q: Array, hanging: list[int], *, level: bool, margin: float = 0.0
) -> list[Finding]:
    """Return the reserves of a standing robot with a floating base; its dynamics end at q.

    A push is a steady horizontal force at the height of the centre of mass; a sway moves the centre of mass. `hanging`
    are indices of unsupported passive joints, `level` is True if a task controls the orientation of the base, `margin`
    is the distance to the position limits, rad.
    """
    model, dynamics = qp.model, qp.dynamics
    bearing = bearing_contacts(qp, active)
    arm = dynamics.com - dynamics.placement(model.frame_id(model.base_link, "base")).translation
    pushes, shifts = {}, static_sways(qp, active, hanging)
    weights = np.repeat([1.0, _FREE, 1.0 if level else _FREE], [2, 1, 3])
    motion = _motion_with_contacts(qp, active, q, hanging, margin)
    for name, direction in _DIRECTIONS.items():
        way = np.array(direction)
        pushes[name] = _largest_multiple(qp, bearing, hanging, np.concatenate([way, np.cross(arm, way)]))
        if motion is not None and np.isfinite(shifts[name].most):
            shifts[name] = motion.largest(way, shifts[name], weights, shifts[name].most / _STEPS, _HALVINGS)
    found = [
        Finding("push", "steady, at the centre of mass: " + _format_directions(pushes, 1.0, "N")),
        Finding("sway", "of the centre of mass: " + _format_directions(shifts, 1e3, "mm")),
    ]
    squat = com_distance(qp, active, q, hanging, -np.eye(3)[2], _DEEPEST * float(dynamics.com[2]), margin)
    if squat is not None:
        found.append(Finding("squat", f"{1e3 * squat.most:.0f} mm straight down ({squat.cause})"))
    return found


def bearing_contacts(qp: WholeBodyQP, active: Sequence[str]) -> list[Contact]:
    """Return the active and the permanent contacts."""
    return [contact for name, contact in qp.contacts.items() if name in active or contact.permanent]


def static_sways(qp: WholeBodyQP, active: Sequence[str], hanging: list[int]) -> dict[str, Reserve]:
    """Return the displacements of the weight by direction that torques and contacts balance without motion."""
    bearing, weight = bearing_contacts(qp, active), qp.model.mass * np.array(qp.model.pinocchio.gravity.linear)
    wrenches = {name: np.concatenate([np.zeros(3), np.cross(way, weight)]) for name, way in _DIRECTIONS.items()}
    return {name: _largest_multiple(qp, bearing, hanging, wrench) for name, wrench in wrenches.items()}


def _format_directions(found: dict[str, Reserve], scale: float, unit: str) -> str:
    parts = []
    for name, balance in found.items():
        size = f"{scale * balance.most:.0f} {unit}" if np.isfinite(balance.most) else "any"
        parts.append(f"{size} {name}" + (f" ({balance.cause})" if balance.cause else ""))
    return ", ".join(parts)


def _largest_multiple(qp: WholeBodyQP, bearing: Sequence[Contact], hanging: list[int], wrench: Array) -> Reserve:
    """Return the largest multiple of a wrench on the base, (6,) about its origin in world axes, possible at rest.

    With S and C of `Actuation`, contact forces f, torques τ, forces of followers λ and the multiple s:

        maximize s    subject to    Jᵀf + Sᵀτ + Cᵀλ + s J_baseᵀ w = h,    cones and bounds of f,    |τ| ≤ τ_max.
    """
    model, dynamics = qp.model, qp.dynamics
    base = dynamics.jacobian(model.frame_id(model.base_link, "base"), pin.LOCAL_WORLD_ALIGNED)
    J = np.vstack([np.zeros((0, model.nv)), *(contact.jacobian(dynamics) for contact in bearing)])
    blocks = [J.T, model.actuation.S.T, model.actuation.C.T, (base.T @ wrench)[:, None]]
    rows = np.delete(np.arange(model.nv), model.v_index[hanging])
    cone = block_diag(*(contact.cone for contact in bearing))
    width = sum(block.shape[1] for block in blocks)
    bounds = [pair for contact in bearing for pair in zip(*contact.bounds(1.0), strict=True)]
    bounds += [(-limit, limit) for limit in model.effort_limits]
    bounds += [(-np.inf, np.inf)] * len(model.actuation.C) + [(0.0, np.inf)]
    inequalities = np.hstack([cone, np.zeros((len(cone), width - cone.shape[1]))]), np.zeros(len(cone))
    equations = np.hstack(blocks)[rows], dynamics.h[rows]
    result = linprog(-np.eye(width)[-1], *inequalities, *equations, bounds, method="highs")
    if result.status == 3:
        return Reserve(np.inf, None)
    if result.x is None:
        return Reserve(0.0, None)
    most, torques = float(result.x[-1]), slice(len(J), len(J) + model.na)
    # The torques are not unique: only a limit with a multiplier is the cause.
    worth = (np.abs(result.lower.marginals) + np.abs(result.upper.marginals))[torques] * model.effort_limits
    worst = int(np.argmax(worth))
    return Reserve(most, model.actuators[worst] if worth[worst] > _MATTERS * most else None)


class _MotionWithContacts:
    """Slow motion of the centre of mass from the configuration q of the dynamics, without slip of the contacts."""

    def __init__(
        self, qp: WholeBodyQP, bearing: Sequence[AnchoredContact], q: Array, hanging: list[int], margin: float
    ) -> None:
        self._qp, self._bearing, self._start, self._hanging, self._margin = qp, bearing, q, hanging, margin
        dynamics = qp.dynamics
        self._base = qp.model.frame_id(qp.model.base_link, "base")
        self._com = dynamics.com.copy()
        self._upright = dynamics.placement(self._base).rotation.copy()
        self._held = [(contact, contact.anchor(dynamics)) for contact in bearing]

    def largest(self, direction: Array, limit: Reserve, weights: Array, step: float, halvings: int = 0) -> Reserve:
        """Search up to a limit in steps, m, and halve the last one; `weights` as in `_reach`."""
        done, far, at, cause = 0.0, np.inf, np.array(self._start), limit.cause
        while done < limit.most and halvings >= 0:
            tried = min(limit.most, done + step, 0.5 * (done + far))
            there, reason = self._reach(self._com + tried * direction, at, weights)
            if not reason and not _largest_multiple(self._qp, self._bearing, self._hanging, np.zeros(6)).most > 0.0:
                reason = "torques or contacts"
            if reason:
                far, cause = tried, reason
            else:
                done, at = tried, there
            halvings -= far < np.inf
        self._qp.dynamics.update(self._start, np.zeros(self._qp.model.nv))
        return Reserve(done, cause)

    def _reach(self, goal: Array, start: Array, weights: Array) -> tuple[Array, str]:
        """Move the centre of mass to a goal, (3,) in m, by Newton's method.

        Returns the configuration, also of the dynamics, and the limiting cause, or "" if the goal is reached. `weights`
        of centre of mass and base orientation, (6,), are 1 if required.
        """
        model, dynamics, at = self._qp.model, self._qp.dynamics, start
        C, least = model.actuation.C, _LEAST_MOTION * np.eye(model.nv)
        for last in [False] * _ITERATIONS + [True]:
            dynamics.update(at, np.zeros(model.nv))
            turned = pin.log3(self._upright @ dynamics.placement(self._base).rotation.T)
            gap = np.concatenate([contact.displacement(dynamics, anchor) for contact, anchor in self._held])
            off = weights * np.concatenate([goal - dynamics.com, turned])
            if last:
                break
            J = np.vstack([contact.jacobian(dynamics) for contact, _ in self._held])
            own = np.vstack([dynamics.com_jacobian, dynamics.jacobian(self._base, pin.LOCAL_WORLD_ALIGNED)[3:]])
            rows = np.vstack([J, weights[:, None] * own, C, least])
            error = np.concatenate([gap, off, np.zeros(len(C) + model.nv)])
            at = np.asarray(pin.integrate(model.pinocchio, at, np.linalg.lstsq(rows, error, rcond=None)[0]))
        if np.abs(off[weights == 1.0]).max() > _REACHED or np.abs(gap).max(initial=0.0) > _HELD:
            return at, "reach"
        beyond = model.joint_beyond_limits(at[model.q_index], self._margin)
        return at, f"position of {beyond}" if beyond else ""


def _motion_with_contacts(
    qp: WholeBodyQP, active: Sequence[str], q: Array, hanging: list[int], margin: float
) -> _MotionWithContacts | None:
    bearing = bearing_contacts(qp, active)
    anchored = [contact for contact in bearing if isinstance(contact, AnchoredContact)]
    if len(anchored) < len(bearing):  # a loop has no displacement
        return None
    return _MotionWithContacts(qp, anchored, q, hanging, margin)


def com_distance(
    qp: WholeBodyQP, active: Sequence[str], q: Array, hanging: list[int], direction: Array, most: float, margin: float
) -> Reserve | None:
    """Return the distance, at most `most` in m, that the centre of mass can move along a unit vector at rest.

    Base level, contacts fixed. None for robots with closed loops. Other arguments as in `reserves`.
    """
    motion = _motion_with_contacts(qp, active, q, hanging, margin)
    if motion is None:
        return None
    return motion.largest(direction, Reserve(most, "limit of the search"), np.ones(6), _STEP)
