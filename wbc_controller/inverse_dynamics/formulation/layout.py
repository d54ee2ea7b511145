"""Rows and columns of the quadratic program.

Decision variables as in `plain_qp`.
"""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wbc_controller.inverse_dynamics.arrays import consecutive
from wbc_controller.inverse_dynamics.contacts import AnchoredContact, Contact
from wbc_controller.inverse_dynamics.formulation.problem import FORCE_UNIT, Level, QuadraticProgram
from wbc_controller.inverse_dynamics.limits import RowLimit
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.dynamics_kernels import DynamicsRows
from wbc_controller.inverse_dynamics.robot.instruction import Instruction
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array


@dataclass(slots=True)
class ContactPlace:
    """Rows and columns of one contact; the arrays are views."""

    contact: Contact
    motion: slice  # rows of the motion constraint in A and b; indices in f
    J: Array  # in A, (k, nv)
    acceleration: Array  # required J v̇ in b, (k,)
    cone: slice  # rows in C
    columns: slice  # columns of the force in x
    lower: Array  # of the force, in `FORCE_UNIT`, (k,)
    upper: Array  # likewise


class Layout:
    """Rows and columns of the problem, for one set of active contacts."""

    def __init__(
        self, dynamics: Dynamics, contacts: Sequence[Contact], limits: Sequence[RowLimit] = (), cost_rows: int = 0
    ) -> None:
        model, actuation, coupling = dynamics.model, dynamics.model.actuation, dynamics.model.actuation.C
        nv, na, sizes = model.nv, model.na, [contact.size for contact in contacts]
        nf = sum(sizes)
        self.key = tuple(contact.name for contact in contacts)  # names of the active contacts
        self.mechanism = slice(nf, nf + len(coupling) + actuation.free)  # rows of A: mimic joints, equations of motion
        self.torque = slice(0, na)  # rows of C of the torque bounds
        self.joints = model.v_index  # columns of the joint accelerations in x, (nj,)
        self.forces = slice(nv, nv + nf)  # columns of all contact forces in x
        self._alone = sum(not contact.internal for contact in contacts) == 1
        cones = [contact.cone_for(1.0, self._alone) for contact in contacts]
        cone_rows = consecutive(map(len, cones), na)
        self.row_limits = tuple(limits)
        self.limits = consecutive((len(limit.names) for limit in limits), na + sum(map(len, cones)))  # rows of C
        inequality = na + sum(map(len, cones)) + sum(len(limit.names) for limit in limits)
        self.problem = problem = QuadraticProgram.empty(nv + nf, self.mechanism.stop, inequality, cost_rows, na)
        #: Rows and bounds of each row limit, as views.
        self.limit_parts = [(problem.C[rows, :nv], problem.lower[rows], problem.upper[rows]) for rows in self.limits]
        problem.A[nf : nf + len(coupling), :nv] = coupling  # C v̇ = 0
        self._rows_in_A = problem.A[:nf, :nv]
        #: [J, b] of the contacts before `formulation.redundancy`, (nf, nv + 1), or None.
        self.contact_rows: Array | None = None
        self.contact_motion = problem.b[:nf]  # right-hand sides of the contacts
        damping = np.concatenate([np.zeros(0), *(c.row_damping() for c in contacts)])
        self.metric = np.concatenate([np.zeros(0), *(c.metric for c in contacts)])  # diagonal of W in ½ ε_f fᵀ W f
        self.places: list[ContactPlace] = []  # of each active contact
        self.instructions: list[tuple[Instruction, int]] = []  # compiled rows of contacts, with their first row
        self.python_contacts: list[ContactPlace] = []  # contacts without instructions
        self.anchored: list[tuple[AnchoredContact, slice]] = []  # with their rows of J
        for contact, cone, motion, columns, rows in zip(
            contacts, cones, consecutive(sizes), consecutive(sizes, nv), cone_rows, strict=True
        ):
            views = problem.A[motion, :nv], problem.b[motion]
            self.places.append(ContactPlace(contact, motion, *views, rows, columns, *problem.bounds[:, columns]))
            if (instruction := contact.instruction()) is not None:
                self.instructions.append((instruction, motion.start))
            else:
                self.python_contacts.append(self.places[-1])
            if isinstance(contact, AnchoredContact) and contact.stiffness > 0.0:
                self.anchored.append((contact, motion))
            problem.C[rows, columns] = cone
            problem.upper[rows] = 0.0
        self._friction: Mapping[str, float] = {}
        self.available = np.zeros((3, na))  # smallest and largest available torques, and effort limits, N·m
        starts, nonzero_columns, values = actuation.projection
        self.dynamics_rows = DynamicsRows(
            starts=starts,
            columns=nonzero_columns,
            values=values,
            damping=damping,
            rows=problem.constraints.rows,
            first=self.mechanism.stop - actuation.free,
            lower=problem.lower[:na],
            upper=problem.upper[:na],
            M=dynamics.M_rows,
            unit=FORCE_UNIT,
            available=self.available,
            bias=problem.offset,
        )
        self.levels: list[Level] = []  # cost of each priority level, highest first
        self._fixed_labels = self._labels(model)
        self.name_limits()

    def _labels(self, model: RobotModel) -> list[tuple[str, str, float]]:
        """Return the labels of x, torques and cones."""
        labels = [("", "", 1.0)] * self.problem.n
        for column, joint in zip(self.joints.tolist(), model.joints, strict=True):
            labels[column] = _both_bounds(f"motion:{joint}", 1.0)
        for place in self.places:
            name, start = place.contact.name, place.columns.start
            for kind, first, last in place.contact.bound_groups:
                labels[start + first : start + last] = [_both_bounds(f"{kind}:{name}", FORCE_UNIT)] * (last - first)
        labels += [_both_bounds(f"torque:{actuator}", 1.0) for actuator in model.actuators]
        for place in self.places:
            labels += [("", f"cone:{place.contact.name}", FORCE_UNIT)] * (place.cone.stop - place.cone.start)
        return labels

    def name_limits(self) -> None:
        """Write the present names of the row limits to a new list of labels."""
        #: Names of both bounds of each entry of [x; C x], and its unit in SI units.
        self.labels = self._fixed_labels + [(name, name, 1.0) for limit in self.row_limits for name in limit.names]

    def set_friction(self, shares: Mapping[str, float]) -> None:
        """Write the cones for a share of the friction of each contact, 1 by default."""
        if shares == self._friction:
            return
        for place in self.places:
            name = place.contact.name
            share = shares.get(name, 1.0)
            if share != self._friction.get(name, 1.0):
                self.problem.C[place.cone, place.columns] = place.contact.cone_for(share, self._alone)
        self._friction = dict(shares)

    @property
    def J(self) -> Array:
        """Stacked Jacobians of the active contacts, (nf, nv)."""
        return self._rows_in_A if self.contact_rows is None else self.contact_rows[:, :-1]

    @property
    def torque_map(self) -> tuple[Array, Array]:
        """Map of `Efforts.torque_map`."""
        return self.problem.C[self.torque], self.problem.offset

    def force_map(self, contact: str) -> Array | None:
        """Return the map of `Efforts.force_map`."""
        if contact not in self.key:
            return None
        columns = self.places[self.key.index(contact)].columns
        return FORCE_UNIT * np.eye(columns.stop - columns.start, self.problem.n, columns.start)

    def snapshot(self) -> "Layout":
        """Return a copy with its own problem; `places` remain views of this one."""
        kept = copy.copy(self)
        kept.problem = self.problem.copy()
        return kept


def _both_bounds(name: str, unit: float) -> tuple[str, str, float]:
    return f"{name}:lower", f"{name}:upper", unit
