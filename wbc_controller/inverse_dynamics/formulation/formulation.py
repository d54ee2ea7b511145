"""Fast formulation of `plain_qp`."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from wbc_controller.errors import MethodError
from wbc_controller.inverse_dynamics.contacts.contact import Contact, anchor_feedback, contact_motion
from wbc_controller.inverse_dynamics.formulation import redundancy
from wbc_controller.inverse_dynamics.formulation.cost import Errors, LevelCost
from wbc_controller.inverse_dynamics.formulation.formulation_kernels import Program, fill_program
from wbc_controller.inverse_dynamics.formulation.layout import ContactPlace, Layout
from wbc_controller.inverse_dynamics.formulation.plain_qp import Regularization, bias_forces
from wbc_controller.inverse_dynamics.formulation.problem import FORCE_UNIT, Level
from wbc_controller.inverse_dynamics.limits import JointMotionLimit, RowLimit, TorqueLimit
from wbc_controller.inverse_dynamics.method_calls import bounds_from, call, require_finite
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.frame_kernels import fill_rows
from wbc_controller.inverse_dynamics.robot.link_motion_kernels import link_terms
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.tasks import Task
from wbc_controller.records import Array, References, RobotState, Tuning


class Parameters(NamedTuple):
    """Numbers of the problem that may change between cycles, other than state and references."""

    weights: Mapping[str, float]  # of tasks
    activations: Mapping[str, float]  # of contacts
    motion_limit: JointMotionLimit
    torque_limit: TorqueLimit
    changes: int  # number of attribute changes (`Tunable.version`)


@dataclass(slots=True)
class Structure:
    """Arrays of the problem for one set of active contacts and tasks."""

    layout: Layout  # also of the structures with other tasks
    costs: list[LevelCost]  # of each priority level, highest first
    levels: list[Level]  # of the costs
    parameters: Parameters | None = None  # in the arrays; None for those of another structure
    program: Program = field(init=False)  # for the kernel


class Formulation:
    """Quadratic program of a state and references; `inverse_dynamics.whole_body_qp` solves it.

    Parameters (weights, gains, limits) are written after changes, state and references in every cycle.
    """

    def __init__(
        self,
        model: RobotModel,
        tasks: Sequence[Task],
        contacts: Sequence[Contact],
        torque_limit: TorqueLimit,
        motion_limit: JointMotionLimit,
        row_limits: Sequence[RowLimit] = (),
        *,
        period: float,
        regularization_acceleration: float = 1.0e-5,
        regularization_force: float = 1.0e-6,
    ) -> None:
        self.model = model
        self.dynamics = Dynamics(model)
        self.tasks: Mapping[str, Task] = {task.name: task for task in tasks}
        self.contacts: Mapping[str, Contact] = {contact.name: contact for contact in contacts}
        self.torque_limit = torque_limit
        self.motion_limit = motion_limit
        self.row_limits = tuple(row_limits)
        self.period = period
        self.regularization = Regularization(regularization_acceleration, regularization_force)
        self.task_errors: tuple[Errors, ...] = ()  # of each level in the last cycle
        self.structure: Structure | None = None
        #: Contacts, True to separate them in every cycle, and examined q (`formulation.redundancy`).
        self.redundancy: tuple[tuple[str, ...], bool, Array] | None = None
        self._owners: tuple[Task | Contact, ...] = (*tasks, *contacts)
        self._levels = sorted({task.level for task in tasks})
        self._layouts: dict[tuple[str, ...], Layout] = {}
        self._structures: dict[tuple[tuple[str, ...], tuple[str, ...]], Structure] = {}  # by contacts and tasks
        self._tuning: Tuning | None = None
        self._prepared: RobotState | None = None  # of the present dynamics

    def layout(self, names: tuple[str, ...]) -> Layout:
        """Return the layout for one set of active contacts."""
        if names not in self._layouts:
            contacts = [self.contacts[name] for name in names]
            rows = sum(task.dimension for task in self.tasks.values() if task.level == self._levels[0])
            rows += 6 + sum(contact.size for contact in contacts)
            self._layouts[names] = Layout(self.dynamics, contacts, self.row_limits, rows)
        return self._layouts[names]

    def prepare(self, state: RobotState) -> None:
        """Compute the dynamics of a state in advance."""
        if self._prepared is not state:
            self.dynamics.update(state.q, state.v)
            self._prepared = state

    def build(self, state: RobotState, references: References, tau_before: Array | None = None) -> Layout:
        """Compute the dynamics and fill the returned layout; `tau_before` as in `WholeBodyQP.solve`."""
        if references.tuning is not None and references.tuning is not self._tuning:
            self._apply_tuning(references.tuning)
        dynamics, q, v = self.dynamics, state.q, state.v
        if self._prepared is not state:
            dynamics.compute(q, v)
        self._prepared = None
        structure = self._current_structure(references)
        layout, costs, program = structure.layout, structure.costs, structure.program
        layout.set_friction(references.friction)
        if self.torque_limit.curve is not None:
            layout.available[:2] = self.torque_limit.available(self.model.actuation.rates(v[self.model.v_places]))
        before, share = layout.available[2], -1.0
        if tau_before is not None:
            before, share = tau_before, self.torque_limit.rate * self.period
        first, errors = costs[0], costs[0].set_references(references)
        if layout.python_contacts:
            link_terms(dynamics.motion, v)
        for place in layout.python_contacts:
            place.J[:], place.acceleration[:] = contact_motion(place.contact, dynamics)
            self._bound_force(place, references.contacts)
        known = self.redundancy
        examined = q if known is None or known[0] != layout.key else known[2]
        h = bias_forces(dynamics, references)
        constant, moved = fill_program(program, q, v, h, before, share, examined, errors)
        if layout.anchored:
            layout.contact_motion += anchor_feedback(len(layout.J), layout.anchored, dynamics, references.anchors)
        found = [first.complete(references, constant, errors)]
        for cost in costs[1:]:
            errors = cost.set_references(references)
            constant = fill_rows(cost.rows.arrays, q, v, errors)
            found.append(cost.complete(references, constant, errors))
        self.task_errors = tuple(found)
        if self.row_limits:
            self._fill_row_limits(layout)
        layout.contact_rows = None
        if known is None or known[0] != layout.key or not moved <= redundancy.EXAMINED_MOTION:
            known = self.redundancy = layout.key, self._mobility(layout) < redundancy.EXAMINED_MOBILITY, q.copy()
        if known[1]:
            self._separate_contacts(layout)
        return layout

    def find_redundancy(self, layout: Layout) -> bool:
        """Separate newly redundant contacts; return True if the problem changes."""
        if layout.contact_rows is not None or self._mobility(layout) >= redundancy.LEAST_MOBILITY:
            return False
        self.redundancy = layout.key, True, self.dynamics.q.copy()
        self._separate_contacts(layout)
        return True

    def _mobility(self, layout: Layout) -> float:
        return float(redundancy.mobilities(layout.J, layout.metric, self.dynamics)[0].min(initial=math.inf))

    def _separate_contacts(self, layout: Layout) -> None:
        nf, nv = layout.J.shape
        rows = layout.J, layout.contact_motion
        hard, soft = redundancy.separate_redundant_rows(*rows, layout.metric, self.dynamics)
        layout.contact_rows = np.column_stack(rows)
        layout.problem.A[:nf, :nv], layout.contact_motion[:] = hard[:, :-1], hard[:, -1]
        if self.structure is not None:
            self.structure.costs[0].add_redundant_rows(soft)

    def add_effort_errors(self, x: Array) -> None:
        """Add the errors of effort tasks at a solution (n,) to `task_errors`."""
        costs = () if self.structure is None else self.structure.costs
        for cost, (_, errors) in zip(costs, self.task_errors, strict=False):
            for rows, place in cost.effort_rows:
                errors[place] = rows[:, :-1] @ x - rows[:, -1]

    def _current_structure(self, references: References) -> Structure:
        changes = self.motion_limit.version + self.torque_limit.version
        for owner in self._owners:
            changes += owner.version
        weights, activations = _read_only(references.weights), _read_only(references.contacts)
        parameters = Parameters(weights, activations, self.motion_limit, self.torque_limit, changes)
        if self.structure is not None and parameters == self.structure.parameters:  # fast for the same objects
            return self.structure
        self.structure = None  # until all are written
        structure = self._structure_for(weights, activations)
        if structure.parameters != parameters:
            structure.parameters = None
            self._write_parameters(parameters, structure)
            structure.parameters = parameters
        self.structure = structure
        return structure

    def _structure_for(self, weights: Mapping[str, float], activations: Mapping[str, float]) -> Structure:
        # A NaN weight is active, for the check for finite values.
        tasks = tuple(name for name in self.tasks if not weights.get(name, 0.0) <= 0.0)
        contacts = tuple(name for name, c in self.contacts.items() if c.permanent or activations.get(name, 0.0) > 0.0)
        if (contacts, tasks) not in self._structures:
            layout, levels, costs = self.layout(contacts), self._levels, []
            for level in levels:
                own = [self.tasks[name] for name in tasks if self.tasks[name].level == level]
                ends = {"first": level == levels[0], "last": level == levels[-1]}
                costs.append(LevelCost(own, layout, self.dynamics, self.regularization, **ends))
            self._structures[contacts, tasks] = Structure(layout, costs, [cost.level for cost in costs])
        structure = self._structures[contacts, tasks]
        layout = structure.layout
        if layout.levels is not structure.levels:
            layout.levels, structure.parameters = structure.levels, None
            layout.problem.memory[: layout.problem.room] = 0.0
        return structure

    def _write_parameters(self, parameters: Parameters, structure: Structure) -> None:
        layout, model, nv = structure.layout, self.model, self.model.nv
        for place in layout.places:
            self._bound_force(place, parameters.activations)
        most = self.torque_limit.effort_limits
        layout.available[:] = -most, most, most
        for cost in structure.costs:
            cost.set_parameters(parameters.weights)
        lower, upper = layout.problem.x_lower[:nv], layout.problem.x_upper[:nv]
        structure.program = Program(
            rows=structure.costs[0].rows.arrays,
            dynamics=layout.dynamics_rows,
            motion_limit=self.motion_limit.bind(model.q_index, model.v_index, self.period, lower, upper),
        )

    def _apply_tuning(self, tuning: Tuning) -> None:
        self._tuning = tuning
        for name, gains in tuning.gains.items():
            for key, value in gains.items():
                setattr(self.tasks[name], key, value)
        motion = self.motion_limit
        self.motion_limit = JointMotionLimit.of(
            self.model, tuning, position=motion.position is not None, velocity=motion.velocity is not None
        )
        torque = self.torque_limit
        self.torque_limit = TorqueLimit(torque.effort_limits, tuning.torque_rate, torque.curve)

    def _bound_force(self, place: ContactPlace, activations: Mapping[str, float]) -> None:
        contact = place.contact
        activation = 1.0 if contact.permanent else activations[contact.name]
        lower, upper = bounds_from(contact, "bounds", contact.size, activation)
        np.divide(lower, FORCE_UNIT, out=place.lower)
        np.divide(upper, FORCE_UNIT, out=place.upper)

    def _fill_row_limits(self, layout: Layout) -> None:
        for limit, parts in zip(self.row_limits, layout.limit_parts, strict=True):
            call(limit, "fill", self.dynamics, self.period, *parts)
            if len(limit.names) != len(parts[1]):
                raise MethodError(
                    f"{limit.full_name}: {type(limit).__name__}.fill() changed the number of names to "
                    f"{len(limit.names)}, expected {len(parts[1])}"
                )
        layout.name_limits()

    def require_finite_limits(self, layout: Layout) -> None:
        """Raise `MethodError` for NaN in the limits at a finite state."""
        if not (np.isfinite(self.dynamics.q).all() and np.isfinite(self.dynamics.v).all()):
            return
        for limit, (rows, *bounds) in zip(self.row_limits, layout.limit_parts, strict=True):
            require_finite(limit, "fill", "rows", rows)
            for name, values in zip(("lower", "upper"), bounds, strict=True):
                if np.isnan(values).any():
                    require_finite(limit, "fill", name, values)

    def effort_bounds(self, references: References) -> tuple[Array, Array]:
        """Return the torque bounds without the rate limit."""
        actuation = self.model.actuation
        lower, upper = self.torque_limit.available(actuation.rates(self.dynamics.v[self.model.v_places]))
        h = actuation.torques(bias_forces(self.dynamics, references))
        return lower - h, upper - h


def _read_only(mapping: Mapping[str, float]) -> Mapping[str, float]:
    return mapping if isinstance(mapping, MappingProxyType) else dict(mapping)
