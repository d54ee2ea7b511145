"""Fills the quadratic program of one cycle: cost, equations of motion, contacts and limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from wbc_controller.core.contacts import Contact
from wbc_controller.core.limits import JointMotionLimit, RowLimit, TorqueLimit
from wbc_controller.core.program.anchors import pull
from wbc_controller.core.program.cost import LevelCost
from wbc_controller.core.program.layout import FORCE_UNIT, Layout
from wbc_controller.core.robot.dynamics import Dynamics
from wbc_controller.core.robot.model import RobotModel
from wbc_controller.core.tasks import EffortTask, Task
from wbc_controller.kernels.compiled import Bound
from wbc_controller.kernels.equations_of_motion import fill_dynamics
from wbc_controller.kernels.frames import fill_rows, link_terms
from wbc_controller.kernels.joint_motion import acceleration_bounds
from wbc_controller.kernels.program import fill_program
from wbc_controller.records import Array, References, RobotState, Tuning


class Formulation:
    """Turns a state and references into a quadratic program; `core.whole_body_qp` solves it.

    Attributes:
        model: the robot's model.
        dynamics: the snapshot of the last cycle.
        tasks: the tasks, by name.
        contacts: the contacts, by name.
        effort_tasks: the tasks on contact forces or torques.
        torque_limit: bounds of the torques.
        motion_limit: bounds of the joint accelerations.
        row_limits: bounds of other combinations of v̇.
        period: time between cycles, s.
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
        """Make a formulation.

        Args:
            model: the robot's model.
            tasks: the tasks.
            contacts: the contacts, active or not.
            torque_limit: bounds of the torques.
            motion_limit: bounds of the joint accelerations.
            row_limits: bounds of other combinations of v̇.
            period: time between cycles, s.
            regularization_acceleration: ε_a.
            regularization_force: ε_f.
        """
        self.model = model
        self.dynamics = Dynamics(model)
        self.tasks: Mapping[str, Task] = {task.name: task for task in tasks}
        self.contacts: Mapping[str, Contact] = {contact.name: contact for contact in contacts}
        self.torque_limit = torque_limit
        self.motion_limit = motion_limit
        self.row_limits = tuple(row_limits)
        self.period = period
        self.effort_tasks = tuple(task for task in tasks if isinstance(task, EffortTask))
        self._tuning: Tuning | None = None
        self._layouts: dict[tuple[str, ...], Layout] = {}
        self._active: tuple[dict[str, float], Layout] | None = None  # activations of the last cycle, and their layout
        self._tabled: tuple[object, object, object] = (None, None, None)  # of what `_tables` was made
        self._tables: Bound
        levels = sorted({task.level for task in tasks})
        self._costs = [
            LevelCost(
                level,
                tasks,
                model,
                last=level == levels[-1],
                regularization_acceleration=regularization_acceleration,
                regularization_force=regularization_force,
            )
            for level in levels
        ]
        self._lower = self._costs[1:]

    @cached_property
    def has_priorities(self) -> bool:
        """Whether a hierarchy of quadratic programs is needed: there are several levels, or tolerances."""
        return len(self._costs) > 1 or any(task.tolerance is not None for task in self.tasks.values())

    def layout(self, names: tuple[str, ...]) -> Layout:
        """Columns, rows and arrays of the problem for one set of active contacts."""
        if names not in self._layouts:
            contacts = [self.contacts[name] for name in names]
            self._layouts[names] = layout = Layout(self.model, contacts, self.row_limits, self._costs[0].rows)
            layout.bind(self.dynamics)
        return self._layouts[names]

    def build(self, state: RobotState, references: References, tau_before: Array | None = None) -> Layout:
        """Compute the dynamics and fill the problem.

        Args:
            state: the latched state of the robot.
            references: task references, weights and contact activations.
            tau_before: the present torques of the actuators, (na,) in N·m; None for no torque rate limit.

        Returns:
            The layout, whose `problem` is ready to be solved, inspected or dumped.
        """
        if references.tuning is not None and references.tuning is not self._tuning:
            self._tune(references.tuning)
        dynamics, first = self.dynamics, self._costs[0]
        dynamics.compute(state.q, state.v)
        layout = self._layout_of(references.contacts)
        rows, errors = first.prepare(layout, dynamics, references)
        self._bound_forces(layout, references)
        limit, q, v = self.torque_limit, state.q, state.v
        available = limit.available(v if limit.curve is None else self.model.actuation.speeds(v))
        before, share = (available[0], -1.0) if tau_before is None else (tau_before, limit.rate * self.period)
        bias = layout.torque_bias = np.empty(len(before))
        tables = self._tables_of(layout, rows)
        if layout.compiled:
            rest = fill_program(
                tables.table, q, v, self.bias(references), *available, before, limit.effort_limits, share, errors, bias
            )
        else:
            link_terms(dynamics.bound.table, v)
            rest = fill_rows(rows.table, q, v, errors)
            self._fill_contacts(layout, references)
            h = self.bias(references)
            fill_dynamics(layout.bound.table, h, v, *available, before, limit.effort_limits, share, bias)
            acceleration_bounds(layout.motion.table, q, v)
        first.complete(dynamics, references, rest)
        for cost in self._lower:
            rows, errors = cost.prepare(layout, dynamics, references)
            cost.complete(dynamics, references, fill_rows(rows.table, q, v, errors))
        layout.levels = [cost.level_of(layout, dynamics, references) for cost in self._costs]
        if self.row_limits:
            self._fill_row_limits(layout)
        return layout

    def _tables_of(self, layout: Layout, rows: Bound) -> Bound:
        """What `kernels.program.fill_program` works on for a layout and its rows, with the limits in force."""
        known = self._tabled
        if layout is not known[0] or rows is not known[1] or self.motion_limit is not known[2]:
            self._tabled = layout, rows, self.motion_limit
            bounds = layout.problem.x_lower, layout.problem.x_upper
            q_index, v_index = (each.astype(np.int64) for each in (self.model.q_index, self.model.v_index))
            layout.motion = self.motion_limit.bind(q_index, v_index, self.period, *bounds)
            parts = self.dynamics.bound, rows, layout.bound, layout.motion
            self._tables = Bound(*(part.table for part in parts))
        return self._tables

    def _layout_of(self, activations: Mapping[str, float]) -> Layout:
        """The layout of the active contacts, with the bounds of their forces."""
        if self._active is None or activations != self._active[0]:
            active = [name for name, c in self.contacts.items() if c.permanent or activations.get(name, 0.0) > 0.0]
            self._active = dict(activations), self.layout(tuple(active))
        return self._active[1]

    def _tune(self, tuning: Tuning) -> None:
        """Apply new gains and limits."""
        self._tuning = tuning
        for name, gains in tuning.gains.items():
            for key, value in gains.items():
                setattr(self.tasks[name], key, value)
        motion = self.motion_limit
        self.motion_limit = JointMotionLimit.of(
            self.model, tuning, position=motion.position_lower is not None, velocity=motion.velocity is not None
        )
        torque = self.torque_limit
        self.torque_limit = TorqueLimit(torque.effort_limits, tuning.torque_rate, torque.curve)

    @property
    def task_errors(self) -> list[tuple[list[tuple[str, slice]], Array, dict[str, Array]]]:
        """Task errors of each level in the last cycle (`LevelCost.errors`)."""
        return [cost.errors for cost in self._costs]

    def bias(self, references: References) -> Array:
        """Bias forces h less the generalized forces of what is known beside the model (equation (22); S4), (nv,)."""
        disturbance = references.disturbance
        if not references.external_wrenches and disturbance is None:
            return self.dynamics.h
        h = np.array(self.dynamics.h) if disturbance is None else self.dynamics.h - disturbance.forces
        for frame, wrench in references.external_wrenches.items():
            h -= self.dynamics.external_force(frame, wrench)
        return h

    def _bound_forces(self, layout: Layout, references: References) -> None:
        """Fill the bounds of the contact forces."""
        for place in layout.places:
            contact = place.contact
            bounds = contact.bounds(1.0 if contact.permanent else references.contacts[contact.name])
            if bounds is not place.bounds:
                np.divide(bounds[0], FORCE_UNIT, out=place.lower)
                np.divide(bounds[1], FORCE_UNIT, out=place.upper)
                place.bounds = bounds

    def _fill_contacts(self, layout: Layout, references: References) -> None:
        """Fill what compiled code does not know of the contacts' motion."""
        for place in layout.by_themselves:
            place.contact.fill(self.dynamics, place.J, place.acceleration)
        if layout.anchored:
            layout.contact_motion += pull(layout, self.dynamics, references.anchors)

    def _fill_row_limits(self, layout: Layout) -> None:
        problem = layout.problem
        for limit, rows in zip(self.row_limits, layout.limits, strict=True):
            limit.fill(
                self.dynamics,
                self.period,
                problem.C[rows, : self.model.nv],
                problem.lower[rows],
                problem.upper[rows],
            )
            layout.relabel(rows, limit.names)

    def effort_bounds(self, references: References) -> tuple[Array, Array]:
        """Bounds of the problem's torque rows from the available torques alone, without the torque rate limit."""
        actuation = self.model.actuation
        lower, upper = self.torque_limit.available(actuation.speeds(self.dynamics.v))
        h = actuation.torques(self.bias(references))
        return lower - h, upper - h
