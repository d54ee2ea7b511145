"""The quadratic program of one cycle, as data: built here and in `controller`, solved elsewhere.

The unknowns are x = [v̇ (nv), f / FORCE_UNIT (nf)]. The torques are eliminated exactly, τ = T (M v̇ + h - Jᵀ f), so that
bounds of τ are rows in x (`actuation.Actuation`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from wbc_controller.core.contacts import AnchoredContact, Contact
from wbc_controller.core.limits import RowLimit
from wbc_controller.core.model import RobotModel
from wbc_controller.records import Array

#: Forces in the problem are in units of 100 N (and 100 N·m), so that all unknowns are of one size. Without it the
#: first-order solvers lose two digits and ProxQP takes feasible problems for infeasible.
FORCE_UNIT = 100.0


@dataclass(slots=True)
class Squares:
    """H = RᵀR + diag(d): the rows of least squares that it was made of.

    Attributes:
        stack: the equalities' A with R below it, (m_eq + r, n).
        rows: R, (r, n).
        first: how many columns come first in which d is 0.
        diagonal: d, (n,), positive in the others.
        inverse: d⁻¹, and 0 where d is 0, (n,).
    """

    stack: Array
    rows: Array
    first: int
    diagonal: Array
    inverse: Array


class Quadratic:
    """½ xᵀHx + gᵀx, where H is not formed before it is asked for: mostly the squares that it is made of are enough.

    Attributes:
        g: (n,).
        squares: of H, as long as it was not asked for.
    """

    __slots__ = ("_H", "g", "squares")

    def __init__(self, H: Array, g: Array) -> None:
        self._H = H
        self.g = g
        self.squares: Squares | None = None

    @property
    def H(self) -> Array:
        """(n, n), symmetric positive definite; from now on it is what counts, and may be changed in place."""
        if self.squares is not None:
            R = self.squares.rows
            np.matmul(R.T, R, out=self._H)
            self._H.reshape(-1)[:: len(self.g) + 1] += self.squares.diagonal
            self.squares = None
        return self._H

    def add(self, rows: Array, right: Array) -> None:
        """Add ½ ‖rows x - right‖² but for its constant, in place: rows (k, n), right (k,)."""
        H = self.H
        H += rows.T @ rows
        self.g -= rows.T @ right


@dataclass(slots=True)
class QuadraticProgram:
    """Minimize ½ xᵀHx + gᵀx subject to A x = b, lower ≤ C x ≤ upper, x_lower ≤ x ≤ x_upper.

    The arrays are filled anew in every cycle; a solver may read them, and must not keep them.

    Attributes:
        cost: ½ xᵀHx + gᵀx.
        A: (m_eq, n).
        b: (m_eq,).
        C: (m_in, n).
        bounds: lower and upper bounds of x and C x in one, (2, n + m_in); -inf and inf where there is none.
        lower: the part of it for C x, (m_in,).
        upper: likewise.
        x_lower: the part of it for x, (n,).
        x_upper: likewise.
        stack: memory of which A is the beginning, with room below for rows of the cost.
    """

    cost: Quadratic
    A: Array
    b: Array
    C: Array
    bounds: Array
    stack: Array | None = None
    lower: Array = field(init=False)
    upper: Array = field(init=False)
    x_lower: Array = field(init=False)
    x_upper: Array = field(init=False)

    def __post_init__(self) -> None:
        n = len(self.g)
        self.x_lower, self.x_upper = self.bounds[:, :n]
        self.lower, self.upper = self.bounds[:, n:]

    @classmethod
    def empty(cls, n: int, equalities: int, inequalities: int, rows: int = 0) -> QuadraticProgram:
        """Allocate a problem without bounds, with room for some rows of the cost."""
        stack = np.zeros((equalities + rows, n))
        return cls(
            cost=Quadratic(np.zeros((n, n)), np.zeros(n)),
            stack=stack,
            A=stack[:equalities],
            b=np.zeros(equalities),
            C=np.zeros((inequalities, n)),
            bounds=np.repeat([[-np.inf], [np.inf]], n + inequalities, axis=1),
        )

    def copy(self) -> QuadraticProgram:
        """A copy that the next cycle does not overwrite."""
        cost = Quadratic(self.H.copy(), self.g.copy())
        return QuadraticProgram(cost, *(part.copy() for part in (self.A, self.b, self.C, self.bounds)))

    @property
    def H(self) -> Array:
        """(n, n), symmetric positive definite."""
        return self.cost.H

    @property
    def g(self) -> Array:
        """(n,)."""
        return self.cost.g

    @property
    def is_finite(self) -> bool:
        """Whether all entries are finite, and no bound is NaN."""
        # The sum of squares is NaN or inf where an entry is (or is beyond 1e150), and takes a third of the time.
        squares = sum(float(np.vdot(part, part)) for part in (self.H, self.g, self.A, self.b, self.C))
        return math.isfinite(squares) and not np.isnan(self.bounds).any()

    def residuals(self, x: Array) -> Residuals:
        """How well x meets the constraints."""
        value = np.concatenate((x, self.C.dot(x)))  # `dot` of a vector takes two thirds of the time of @
        room = value - self.bounds
        np.negative(room[1], out=room[1])
        equalities = np.abs(self.A.dot(x) - self.b)
        least = float(np.minimum.reduce(room, axis=None, initial=np.inf))
        off = float(np.maximum.reduce(equalities, initial=0.0))
        violation = max(0.0, -least, off) if least == least and off == off else math.nan  # max loses a NaN
        return Residuals(value, equalities, room, least, violation)

    def violation(self, x: Array) -> float:
        """Largest amount by which x breaks a constraint; NaN where x has one."""
        return self.residuals(x).violation

    def objective(self, x: Array) -> float:
        """Value of ½ xᵀHx + gᵀx."""
        return float(0.5 * x @ self.H @ x + self.g @ x)


@dataclass(slots=True)
class Residuals:
    """How well a point meets the constraints.

    Attributes:
        value: x and C x in one, (n + m_in,).
        equalities: |A x - b|, (m_eq,).
        room: how far x and C x are above their lower and below their upper bounds, (2, n + m_in); negative beyond.
        least_room: the smallest of it.
        violation: largest amount by which a constraint is broken, 0 where none is; NaN where x or the problem has one.
    """

    value: Array
    equalities: Array
    room: Array
    least_room: float
    violation: float


@dataclass(slots=True)
class Level:
    """What the tasks of one priority ask for: minimize ½ xᵀHx + gᵀx + ½ ‖s‖² + constant, lower ≤ G x + s ≤ upper.

    Attributes:
        tasks: names of the tasks that take part in this cycle.
        cost: ½ xᵀHx + gᵀx, the regularization included, so that H is positive definite.
        constant: makes the cost the sum of squares that it is.
        kept: rows of the tasks' least-squares problem, weighted, (r, n): what no level below may change. Empty where
            there is no level below.
        G: rows of the tasks with a tolerance, weighted, (k, n).
        lower: (k,).
        upper: (k,).
    """

    tasks: tuple[str, ...]
    cost: Quadratic
    constant: float
    kept: Array
    G: Array
    lower: Array
    upper: Array

    @property
    def H(self) -> Array:
        """(n, n), positive definite."""
        return self.cost.H

    @property
    def g(self) -> Array:
        """(n,)."""
        return self.cost.g

    def add(self, rows: Array, right: Array, *, kept: bool) -> None:
        """Add ½ ‖rows x - right‖² to the cost, in place: rows (k, n), right (k,).

        Args:
            rows: weighted.
            right: weighted.
            kept: whether there is a level below, which may not change them.
        """
        self.cost.add(rows, right)
        self.constant += 0.5 * float(right @ right)
        if kept:
            self.kept = np.vstack([self.kept, rows])


class Layout:
    """Where each quantity stands in the problem, for one set of made contacts.

    Attributes:
        contacts: the made contacts, in order.
        problem: the problem's arrays.
        forces: for each contact, the columns of its force in x.
        force_rows: for each contact, the same among the forces alone, and in J.
        motion: for each contact, the rows of its motion in A and b, in the order of J.
        mechanism: rows of A that always hold: the unactuated part of the equations of motion, and joints that follow
            others.
        unactuated: the first of them, of the equations of motion.
        torque: rows of C of the torque bounds.
        cones: for each contact, the rows of C of its cone.
        row_limits: the limits on combinations of v̇.
        limits: for each of these, its rows of C.
        joints: columns of x of the joints' accelerations, (nj,).
        torque_bias: of the torques, what the rows of C leave out, (na,) in N·m: τ = C x + this.
        levels: the cost, by priority; `H` and `g` of the problem are those of the first.
        key: names of the made contacts.
        labels: for each bound of x and row of C the names of its lower and of its upper bound, and their unit in the
            problem's.
    """

    def __init__(
        self, model: RobotModel, contacts: Sequence[Contact], limits: Sequence[RowLimit] = (), cost_rows: int = 0
    ) -> None:
        nv, na = model.nv, model.na
        self.contacts = tuple(contacts)
        sizes = [contact.size for contact in contacts]
        nf = sum(sizes)
        coupling = model.actuation.C
        self.unactuated = slice(0, model.actuation.free)
        self.mechanism = slice(0, model.actuation.free + len(coupling))
        self.torque = slice(0, na)
        self.joints = model.v_index
        self.forces: list[slice] = []
        self.motion: list[slice] = []
        self.cones: list[slice] = []
        column, row, inequality = nv, self.mechanism.stop, na
        for contact in contacts:
            self.forces.append(slice(column, column + contact.size))
            self.motion.append(slice(row, row + contact.size))
            self.cones.append(slice(inequality, inequality + len(contact.cone)))
            column += contact.size
            row += contact.size
            inequality += len(contact.cone)
        self.limits: list[slice] = []
        self.row_limits = tuple(limits)
        for limit in limits:
            self.limits.append(slice(inequality, inequality + len(limit.names)))
            inequality += len(limit.names)
        self.problem = QuadraticProgram.empty(nv + nf, row, inequality, cost_rows)
        self.problem.A[self.unactuated.stop : self.mechanism.stop, :nv] = coupling  # C v̇ = 0
        for contact, columns, rows in zip(contacts, self.forces, self.cones, strict=True):
            self.problem.C[rows, columns] = contact.cone
            self.problem.upper[rows] = 0.0
        self.torque_bias = np.zeros(na)
        self.levels: list[Level] = []
        self.acceleration_columns = slice(0, nv)
        self.force_columns = slice(nv, nv + nf)
        self.J = self.problem.A[self.mechanism.stop :, self.acceleration_columns]  # stacked contact Jacobians
        # The parts of the equations of motion: those without actuators, and those that give the torques.
        self.free_motion = self.problem.A[self.unactuated, self.acceleration_columns]
        self.free_forces = self.problem.A[self.unactuated, self.force_columns]
        self.torque_motion = self.problem.C[self.torque, self.acceleration_columns]
        self.torque_forces = self.problem.C[self.torque, self.force_columns]
        #: Bounds of the joints' accelerations that stand in the problem.
        self.motion_bounds: tuple[Array, Array] | None = None
        #: Bounds of each contact's force that stand in the problem.
        self.force_bounds: list[tuple[Array, Array] | None] = [None for _ in contacts]
        self.force_rows = [slice(columns.start - nv, columns.stop - nv) for columns in self.forces]
        #: The contacts that go back to where they were made, and their rows of J.
        self.anchored = tuple(
            (contact, rows)
            for contact, rows in zip(contacts, self.force_rows, strict=True)
            if isinstance(contact, AnchoredContact) and contact.stiffness > 0.0
        )
        self.key = tuple(contact.name for contact in contacts)
        self.labels = self._labels(model)

    def _labels(self, model: RobotModel) -> list[tuple[str, str, float]]:
        n = len(self.problem.g)
        labels = [("", "", 1.0)] * self.problem.bounds.shape[1]

        def label(start: int, stop: int, name: str, unit: float) -> None:
            labels[start:stop] = [(f"{name}:lower", f"{name}:upper", unit)] * (stop - start)

        for row, actuator in enumerate(model.actuators, n + self.torque.start):
            label(row, row + 1, f"torque:{actuator}", 1.0)
        for column, joint in zip(self.joints.tolist(), model.joints, strict=True):
            label(column, column + 1, f"motion:{joint}", 1.0)
        for contact, columns, rows in zip(self.contacts, self.forces, self.cones, strict=True):
            for kind, first, last in contact.bound_groups:
                label(columns.start + first, columns.start + last, f"{kind}:{contact.name}", FORCE_UNIT)
            labels[n + rows.start : n + rows.stop] = [("", f"cone:{contact.name}", FORCE_UNIT)] * len(contact.cone)
        for limit, rows in zip(self.row_limits, self.limits, strict=True):
            labels[n + rows.start : n + rows.stop] = [(name, name, 1.0) for name in limit.names]
        return labels

    def relabel(self, rows: slice, names: Sequence[str]) -> None:
        """Name some rows of C anew."""
        n = len(self.problem.g)
        self.labels[n + rows.start : n + rows.stop] = [(name, name, 1.0) for name in names]
