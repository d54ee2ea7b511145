"""Fills the quadratic program of one cycle: cost, equations of motion, contacts and limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from wbc_controller.compiled import Bound
from wbc_controller.errors import MethodError
from wbc_controller.inverse_dynamics.contacts.contact import Contact, evaluate
from wbc_controller.inverse_dynamics.formulation.anchors import pull
from wbc_controller.inverse_dynamics.formulation.cost import Errors, LevelCost
from wbc_controller.inverse_dynamics.formulation.formulation_kernels import fill_program
from wbc_controller.inverse_dynamics.formulation.layout import FORCE_UNIT, ContactPlace, Layout
from wbc_controller.inverse_dynamics.formulation.problem import Squares
from wbc_controller.inverse_dynamics.formulation.rows import Rows
from wbc_controller.inverse_dynamics.limits import JointMotionLimit, RowLimit, TorqueLimit
from wbc_controller.inverse_dynamics.limits.joint_motion_kernels import acceleration_bounds
from wbc_controller.inverse_dynamics.method_calls import bounds_of, call, is_finite, raised, require_finite
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.robot.dynamics_kernels import fill_dynamics
from wbc_controller.inverse_dynamics.robot.frame_kernels import fill_rows, link_terms
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.tasks import EffortTask, Task
from wbc_controller.inverse_dynamics.tunable import Tunable
from wbc_controller.records import Array, References, RobotState, Tuning

_NO_OTHERS: dict[str, Array] = {}


class _Ready(NamedTuple):
    """What is laid out and weighed for all cycles in which nothing but state and references changes.

    Attributes:
        read_only: activations and weights for which it was made, where they are read-only: these stay as they are.
        contacts: activations for which it was made.
        weights: weights for which it was made.
        limits: limits of joint motion and of torques for which it was made.
        changes: how often gains and limits of tasks and contacts had been set (`Tunable`).
        layout: of the active contacts.
        rows: of the contacts and the first level's tasks.
        motion: the bounds of joint accelerations, for compiled code.
        tables: all that `formulation.formulation_kernels.fill_program` works on.
        squares: the only level's cost, where compiled code fills all of it.
        share: largest change of the torques, as a share of their limits.
        falling: whether the available torques fall with the speed.
    """

    read_only: tuple[Mapping[str, float] | None, ...]
    contacts: dict[str, float]
    weights: dict[str, float]
    limits: tuple[JointMotionLimit, TorqueLimit]
    changes: int
    layout: Layout
    rows: Rows
    motion: Bound
    tables: Bound
    squares: Squares | None
    share: float
    falling: bool


class Formulation:
    """Turns a state and references into a quadratic program; `inverse_dynamics.whole_body_qp` solves it.

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
        task_errors: task errors of each level in the last cycle.
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
        self.task_errors: tuple[Errors, ...] = ()
        self._tuning: Tuning | None = None
        self._layouts: dict[tuple[str, ...], Layout] = {}
        self._ready: _Ready | None = None
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
        tuning, dynamics, q, v = references.tuning, self.dynamics, state.q, state.v
        if tuning is not None and tuning is not self._tuning:
            self._tune(tuning)
        dynamics.compute(q, v)
        ready, contacts, weights = self._ready, references.contacts, references.weights
        if (
            ready is None
            or (contacts is not ready.read_only[0] and contacts != ready.contacts)
            or (weights is not ready.read_only[1] and weights != ready.weights)
            or ready.limits[0] is not self.motion_limit
            or ready.limits[1] is not self.torque_limit
            or ready.changes != Tunable.changes
        ):
            ready = self._ready = self._prepare(references)
        layout = ready.layout
        errors = ready.rows.follow(references.tasks)
        if ready.falling:
            layout.available[:2] = self.torque_limit.available(self.model.actuation.speeds(v))
        before, share = (layout.available[2], -1.0) if tau_before is None else (tau_before, ready.share)
        if layout.compiled:
            known = references.disturbance is not None or references.external_wrenches  # beside the model
            h, table = self.bias(references) if known else dynamics.h, ready.tables.table
            rest = fill_program(table, q, v, h, before, share, errors)
        else:
            link_terms(dynamics.bound.table, v)
            rest = fill_rows(ready.rows.bound.table, q, v, errors)
            self._fill_contacts(layout, references)
            h = self.bias(references)
            fill_dynamics(layout.bound.table, h, v, before, share)
            acceleration_bounds(ready.motion.table, q, v)
        if ready.squares is not None:
            ready.squares.constant = rest
            layout.problem.cost.formed = False
            self.task_errors = ((ready.rows.places, errors, _NO_OTHERS),)
        else:
            self._complete(layout, references, rest, errors)
        if self.row_limits:
            self._fill_row_limits(layout)
        return layout

    def _prepare(self, references: References) -> _Ready:
        """Lay out and weigh all that depends on activations, weights, gains and limits."""
        activations, limits, known = references.contacts, (self.motion_limit, self.torque_limit), self._ready
        changes = Tunable.changes
        active = [name for name, c in self.contacts.items() if c.permanent or activations.get(name, 0.0) > 0.0]
        layout = self.layout(tuple(active))
        for place in layout.places:
            self._bound_force(place, activations)
        most, falling = self.torque_limit.effort_limits, self.torque_limit.curve is not None
        layout.available[:] = -most, most, most
        rows, *_ = [cost.prepare(layout, self.dynamics, references.weights) for cost in self._costs]
        same = known is not None and known.changes == changes and known.limits == limits
        if known is not None and same and known.layout is layout and known.rows is rows:
            motion, tables = known.motion, known.tables
        else:
            q_index, v_index = (each.astype(np.int64) for each in (self.model.q_index, self.model.v_index))
            nv, problem = self.model.nv, layout.problem
            bounds = problem.x_lower[:nv], problem.x_upper[:nv]
            motion = self.motion_limit.bind(q_index, v_index, self.period, *bounds)
            parts = self.dynamics.bound, rows.bound, layout.bound, motion
            tables = Bound(*(part.table for part in parts))
        squares, first = None, self._costs[0]
        if len(self._costs) == 1 and first.compiled:  # only its numbers change from cycle to cycle
            squares, layout.levels = first.pose(), [first.posed]
        share = self.torque_limit.rate * self.period
        given = activations, references.weights
        read_only = tuple(each if isinstance(each, MappingProxyType) else None for each in given)
        weighed = dict(activations), dict(references.weights)
        return _Ready(read_only, *weighed, limits, changes, layout, rows, motion, tables, squares, share, falling)

    def _complete(self, layout: Layout, references: References, rest: float, errors: Array) -> None:
        """Fill what compiled code does not know of the tasks, and the levels below the first."""
        dynamics, levels, found = self.dynamics, [], []
        for cost in self._costs:
            if cost is not self._costs[0]:
                rows = cost.rows_of
                errors = rows.follow(references.tasks)
                rest = fill_rows(rows.bound.table, dynamics.q, dynamics.v, errors)
            found.append(cost.complete(dynamics, references, rest, errors))
            levels.append(cost.level_of(layout, dynamics, references, found[-1]))
        layout.levels, self.task_errors = levels, tuple(found)

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

    def bias(self, references: References) -> Array:
        """Bias forces h less the generalized forces of what is known beside the model (equation (22); S4), (nv,)."""
        disturbance = references.disturbance
        if not references.external_wrenches and disturbance is None:
            return self.dynamics.h
        h = np.array(self.dynamics.h) if disturbance is None else self.dynamics.h - disturbance.forces
        for frame, wrench in references.external_wrenches.items():
            h -= self.dynamics.external_force(frame, wrench)
        return h

    def _bound_force(self, place: ContactPlace, activations: Mapping[str, float]) -> None:
        """Fill the bounds of a contact's force."""
        contact = place.contact
        bounds = call(contact, "bounds", 1.0 if contact.permanent else activations[contact.name])
        if bounds is not place.bounds:
            bounds = bounds_of(contact, "bounds", bounds, contact.size)
            np.divide(bounds[0], FORCE_UNIT, out=place.lower)
            np.divide(bounds[1], FORCE_UNIT, out=place.upper)
            place.bounds = bounds

    def _fill_contacts(self, layout: Layout, references: References) -> None:
        """Fill what compiled code does not know of contacts: some know alone what they depend on."""
        for place in layout.by_themselves:
            contact = place.contact
            try:
                contact.fill(self.dynamics, place.J, place.acceleration)
            except Exception as error:
                evaluate(contact, self.dynamics)  # names the method, if it fails by itself
                raise error if isinstance(error, MethodError) else raised(contact, "fill", error) from error
            if not (is_finite(place.J) and is_finite(place.acceleration)):
                evaluate(contact, self.dynamics)
            self._bound_force(place, references.contacts)
        if layout.anchored:
            layout.contact_motion += pull(layout, self.dynamics, references.anchors)

    def _fill_row_limits(self, layout: Layout) -> None:
        for limit, rows, parts in zip(self.row_limits, layout.limits, layout.limit_parts, strict=True):
            try:
                limit.fill(self.dynamics, self.period, *parts)
            except Exception as error:
                raise error if isinstance(error, MethodError) else raised(limit, "fill", error) from error
            if len(limit.names) != len(parts[1]):
                raise MethodError(
                    f"{limit.full_name}: {type(limit).__name__}.fill() changed the number of names to "
                    f"{len(limit.names)}, expected {len(parts[1])}: the number of rows must not change"
                )
            layout.relabel(rows, limit.names)

    def require_finite_limits(self, layout: Layout) -> None:
        """Check the rows and bounds that the limits have written for the last problem, if its state is finite.

        Raises:
            MethodError: if there is NaN, or an infinite entry of G.
        """
        if not (np.isfinite(self.dynamics.q).all() and np.isfinite(self.dynamics.v).all()):
            return
        for limit, (rows, lower, upper) in zip(self.row_limits, layout.limit_parts, strict=True):
            require_finite(limit, "fill", "rows", rows)
            for name, bounds in (("lower", lower), ("upper", upper)):
                if np.isnan(bounds).any():
                    require_finite(limit, "fill", name, bounds)

    def effort_bounds(self, references: References) -> tuple[Array, Array]:
        """Bounds of the problem's torque rows from the available torques alone, without the torque rate limit."""
        actuation = self.model.actuation
        lower, upper = self.torque_limit.available(actuation.speeds(self.dynamics.v))
        h = actuation.torques(self.bias(references))
        return lower - h, upper - h
