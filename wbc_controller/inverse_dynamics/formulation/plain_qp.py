"""Definition of the quadratic program in plain NumPy.

Start reading here: `Formulation` computes the same with kernels and caches; tests compare both.

Decision variables: x = [v̇ (nv), f / FORCE_UNIT (nf)], the accelerations and the forces of active contacts. The torques
τ = T (M v̇ + h - Jᵀf) are eliminated (`robot.actuation`), so their bounds are rows of C.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wbc_controller.inverse_dynamics.arrays import consecutive
from wbc_controller.inverse_dynamics.contacts.contact import AnchoredContact, Contact, anchor_feedback, contact_motion
from wbc_controller.inverse_dynamics.formulation.problem import FORCE_UNIT
from wbc_controller.inverse_dynamics.formulation.redundancy import separate_redundant_rows
from wbc_controller.inverse_dynamics.limits import JointMotionLimit, RowLimit, TorqueLimit
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.tasks import AccelerationTask, EffortTask, Task
from wbc_controller.inverse_dynamics.tasks.task import Efforts, equation_of, task_motion
from wbc_controller.records import Array, Reference, References

ROTATION_LENGTH = 0.1  # from angular to linear momentum, m


@dataclass(frozen=True)
class Limits:
    """Limits of a robot."""

    torque: TorqueLimit
    motion: JointMotionLimit
    rows: Sequence[RowLimit]  # bounds of combinations G v̇
    period: float  # s


@dataclass(frozen=True)
class Regularization:
    """Weights of the regularization ½ ε_a (‖q̈‖² + ‖ḣ_G / m‖²) + ½ ε_f fᵀ W f."""

    acceleration: float = 1.0e-5  # ε_a
    force: float = 1.0e-6  # ε_f


@dataclass
class PlainQP:
    """Minimize ½ xᵀHx + gᵀx subject to A x = b, lower ≤ C x ≤ upper, x_lower ≤ x ≤ x_upper."""

    H: Array  # (n, n)
    g: Array  # (n,)
    A: Array  # (m_eq, n)
    b: Array  # (m_eq,)
    C: Array  # (m_in, n)
    lower: Array  # (m_in,)
    upper: Array  # (m_in,)
    x_lower: Array  # (n,)
    x_upper: Array  # (n,)
    torque_map: tuple[Array, Array]  # R (na, n) and r (na,) of τ = R x + r
    columns: dict[str, slice]  # columns of each active contact's force in x

    def force_map(self, contact: str) -> Array | None:
        """Return the map of `Efforts.force_map`."""
        return FORCE_UNIT * np.eye(len(self.g))[self.columns[contact]] if contact in self.columns else None


def task_rows(
    task: Task, dynamics: Dynamics, efforts: Efforts, reference: Reference, n: int
) -> tuple[Array, Array, Array] | None:
    """Return rows R x = r, R (k, n) and r (k,), and the task error (k,); None for an inactive contact's force.

    Acceleration tasks: J v̇ = ẍ_ref + D (ẋ_ref - ẋ) + K e - J̇v (`MotionTask`). The error of an effort task depends on
    the solution and is NaN here.
    """
    if isinstance(task, EffortTask):
        equation = equation_of(task, efforts, reference, n)
        return None if equation is None else (*equation, np.full(task.dimension, np.nan))
    if not isinstance(task, AccelerationTask):
        return None
    J, right, error = task_motion(task, dynamics, reference)
    return in_columns(J, 0, n), right, error


def bias_forces(dynamics: Dynamics, references: References) -> Array:
    """Return h minus known forces: external wrenches Σ Jₖᵀwₖ (equation (22) of the note; S4), and the disturbance."""
    disturbance = references.disturbance
    if not references.external_wrenches and disturbance is None:
        return dynamics.h
    h = np.array(dynamics.h) if disturbance is None else dynamics.h - disturbance.forces
    for frame, wrench in references.external_wrenches.items():
        h -= dynamics.external_force(frame, wrench)
    return h


def plain_qp(
    dynamics: Dynamics,
    tasks: Sequence[Task],
    contacts: Sequence[Contact],
    limits: Limits,
    references: References,
    tau_before: Array | None = None,
    regularization: Regularization = Regularization(),
    *,
    first: bool = True,
) -> PlainQP:
    """Build the quadratic program at one state.

    Args:
        tasks: of one priority level, without tolerances.
        tau_before: present torques, (na,) in N·m; None for no torque rate limit.
        first: True for the highest level, which has the redundant directions of the contacts.
    """
    model, actuation, period = dynamics.model, dynamics.model.actuation, limits.period
    activations = {c.name: 1.0 if c.permanent else references.contacts.get(c.name, 0.0) for c in contacts}
    active = [contact for contact in contacts if activations[contact.name] > 0.0]
    nv, sizes = model.nv, [contact.size for contact in active]
    columns = dict(zip((contact.name for contact in active), consecutive(sizes, nv), strict=True))
    n = nv + sum(sizes)

    # Equations of motion: N (M v̇ + h - Jᵀf) = 0, τ = T (M v̇ + h - Jᵀf); mimic joints: C v̇ = 0.
    J, J_acceleration = contact_accelerations(dynamics, active, references)
    h = actuation.split(bias_forces(dynamics, references))  # [N; T] h
    rows = actuation.split(np.hstack([dynamics.M, -FORCE_UNIT * J.T]))  # [N; T] [M, -Jᵀ]
    free = actuation.free
    torque_map = rows[free:], h[free:]

    # Contacts: J v̇ = -J̇v - D J v + K e; force bounds; cone C f ≤ 0.
    metric = np.concatenate([np.zeros(0), *(contact.metric for contact in active)])
    motion, redundant = separate_redundant_rows(J, J_acceleration, metric, dynamics)
    A = np.vstack([in_columns(motion[:, :-1], 0, n), in_columns(actuation.C, 0, n), rows[:free]])
    b = np.concatenate([motion[:, -1], np.zeros(len(actuation.C)), -h[:free]])
    x_lower, x_upper = np.full(n, -np.inf), np.full(n, np.inf)
    cone, alone = np.zeros((0, n)), sum(not contact.internal for contact in active) == 1
    for contact in active:
        own = columns[contact.name]
        lower, upper = contact.bounds(activations[contact.name])
        x_lower[own], x_upper[own] = lower / FORCE_UNIT, upper / FORCE_UNIT
        allowed = contact.cone_for(references.friction.get(contact.name, 1.0), alone)
        cone = np.vstack([cone, in_columns(allowed, own.start, n)])

    # Limits: joint motion, τ, and other combinations G v̇.
    joints = dynamics.q[model.q_index], dynamics.v[model.v_index]
    x_lower[model.v_index], x_upper[model.v_index] = limits.motion.bounds(*joints, period)
    tau_lower, tau_upper = torque_bounds(limits, actuation.rates(joints[1]), tau_before)
    C = [torque_map[0], cone]
    C_lower = [tau_lower - torque_map[1], np.full(len(cone), -np.inf)]
    C_upper = [tau_upper - torque_map[1], np.zeros(len(cone))]
    for limit in limits.rows:
        G, lower, upper = np.zeros((len(limit.names), nv)), np.zeros(len(limit.names)), np.zeros(len(limit.names))
        limit.fill(dynamics, period, G, lower, upper)
        C.append(in_columns(G, 0, n))
        C_lower.append(lower)
        C_upper.append(upper)
    bounds = np.concatenate(C_lower), np.concatenate(C_upper), x_lower, x_upper
    qp = PlainQP(np.zeros((n, n)), np.zeros(n), A, b, np.vstack(C), *bounds, torque_map, columns)

    # Regularization: q̈, f, and the momentum rate ḣ_G = A_G v̇ + Ȧ_G v.
    base = 6 if model.floating_base else 0
    qp.H[range(base, nv), range(base, nv)] = regularization.acceleration
    qp.H[range(nv, n), range(nv, n)] = regularization.force * FORCE_UNIT**2 * metric
    if model.floating_base:
        scale = np.repeat([1.0, 1.0 / ROTATION_LENGTH], 3) / model.mass
        momentum = in_columns(scale[:, None] * dynamics.centroidal_matrix, 0, n)
        add_squares(qp, regularization.acceleration, momentum, -scale * dynamics.centroidal_drift)

    # Redundant contact directions and tasks: ½ Σ wᵢ ‖Rᵢ x - rᵢ‖².
    if first:
        add_squares(qp, 1.0, in_columns(redundant[:, :-1], 0, n), redundant[:, -1])
    for task in tasks:
        weight = references.weights.get(task.name, 0.0)
        if weight > 0.0 and (found := task_rows(task, dynamics, qp, references.tasks[task.name], n)) is not None:
            add_squares(qp, weight, found[0], found[1])
    return qp


def contact_accelerations(dynamics: Dynamics, active: Sequence[Contact], references: References) -> tuple[Array, Array]:
    """Return J (nf, nv), and the required J v̇ = -J̇v - D J v + K e, (nf,)."""
    J, at_rest, D = np.zeros((0, dynamics.model.nv)), np.zeros(0), np.zeros(0)
    anchored = []
    for contact in active:
        own_J, own_at_rest = contact_motion(contact, dynamics)
        if isinstance(contact, AnchoredContact) and contact.stiffness > 0.0:
            anchored.append((contact, slice(len(J), len(J) + contact.size)))
        J, at_rest = np.vstack([J, own_J]), np.concatenate([at_rest, own_at_rest])
        D = np.concatenate([D, contact.row_damping()])
    return J, at_rest - D * (J @ dynamics.v) + anchor_feedback(len(J), anchored, dynamics, references.anchors)


def torque_bounds(limits: Limits, speeds: Array, tau_before: Array | None) -> tuple[Array, Array]:
    """Return bounds of τ, (na,) in N·m, by available torques and rate."""
    lower, upper = limits.torque.available(speeds)
    if tau_before is None:
        return lower, upper
    before = np.clip(tau_before, lower, upper)
    step = limits.torque.rate * limits.period * limits.torque.effort_limits
    return np.maximum(lower, before - step), np.minimum(upper, before + step)


def in_columns(block: Array, start: int, n: int) -> Array:
    """Return rows (k, n): a block (k, m) in the columns from `start` on, and zeros."""
    rows = np.zeros((len(block), n))
    rows[:, start : start + block.shape[1]] = block
    return rows


def add_squares(qp: PlainQP, weight: float, R: Array, r: Array) -> None:
    """Add ½ w ‖R x - r‖² to the cost: H += w RᵀR, g -= w Rᵀr."""
    qp.H += weight * R.T @ R
    qp.g -= weight * R.T @ r
