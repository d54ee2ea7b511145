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
from wbc_controller.kernels.equations_of_motion import fill_dynamics
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
        self._joints = model.q_index.astype(np.int64), model.v_index.astype(np.int64)
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
            self._layouts[names] = Layout(self.model, contacts, self.row_limits, self._costs[0].rows)
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
        dynamics = self.dynamics
        dynamics.update(state.q, state.v)
        layout = self._layout_of(references.contacts)
        for cost in self._costs:
            cost.fill_rows(layout, dynamics, references)
        self._fill_contacts(layout, references)
        self._fill_equations_of_motion(layout, references, tau_before)
        layout.levels = [cost.level_of(layout, dynamics, references) for cost in self._costs]
        bounds = layout.problem.x_lower, layout.problem.x_upper
        self.motion_limit.fill(self._joints, dynamics.q, dynamics.v, self.period, *bounds)
        if self.row_limits:
            self._fill_row_limits(layout)
        return layout

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

    def _fill_equations_of_motion(self, layout: Layout, references: References, tau_before: Array | None) -> None:
        dynamics, limit = self.dynamics, self.torque_limit
        lower, upper = limit.available(
            self.model.actuation.speeds(dynamics.v) if limit.curve is not None else dynamics.v
        )
        share = limit.rate * self.period if tau_before is not None else -1.0
        bias = layout.torque_bias = np.empty(len(lower))
        fill_dynamics(
            *layout.dynamics_rows, dynamics.M_rows, self.bias(references), dynamics.v, lower, upper,
            lower if tau_before is None else tau_before, limit.effort_limits, share, bias,
        )  # fmt: skip

    def bias(self, references: References) -> Array:
        """Bias forces h less the generalized forces of what is known beside the model (equation (22); S4), (nv,)."""
        disturbance = references.disturbance
        if not references.external_wrenches and disturbance is None:
            return self.dynamics.h
        h = np.array(self.dynamics.h) if disturbance is None else self.dynamics.h - disturbance.forces
        for frame, wrench in references.external_wrenches.items():
            h -= self.dynamics.external_force(frame, wrench)
        return h

    def _fill_contacts(self, layout: Layout, references: References) -> None:
        dynamics = self.dynamics
        for place in layout.by_themselves:
            place.contact.fill(dynamics, place.J, place.acceleration)
        for place in layout.places:
            contact = place.contact
            bounds = contact.bounds(1.0 if contact.permanent else references.contacts[contact.name])
            if bounds is not place.bounds:
                np.divide(bounds[0], FORCE_UNIT, out=place.lower)
                np.divide(bounds[1], FORCE_UNIT, out=place.upper)
                place.bounds = bounds
        if layout.anchored:
            layout.contact_motion += pull(layout, dynamics, references.anchors)

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
