"""Reference board: commanded changes and sampled references."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from wbc_controller.errors import InputRefused
from wbc_controller.inverse_dynamics.contacts import AnchoredContact, Contact, UnilateralContact
from wbc_controller.inverse_dynamics.contacts.contact import anchor_of, needed_activation
from wbc_controller.inverse_dynamics.references.changes import (
    Change,
    EnableContact,
    EnableTask,
    SetExternalWrench,
    SetSetpoint,
    SetSlippingContacts,
    SetTrajectory,
    SetWeight,
)
from wbc_controller.inverse_dynamics.references.ranges import PositionRange, check_position, position_range
from wbc_controller.inverse_dynamics.references.relative import in_world
from wbc_controller.inverse_dynamics.references.trajectories import Knot, SoftRamp, Trajectory, TuningRamp
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.tasks.task import Task, rest_of
from wbc_controller.records import Array, Reference, References, Tuning, frozen_mapping

_SHORTEST_JOIN = 0.05  # shortest motion to a first trajectory point off the reference's path, s
_SHORTEST_MOVE = 1.0e-3  # shortest duration of a setpoint without a jump, s
#: Share of the friction of a slipping contact; durations of its reduction, and of its recovery at rest, s.
_SLIPPING_FRICTION, _REDUCTION, _RECOVERY = 0.05, 0.02, 2.0
_LARGEST_DEVIATION = 1.0e-3  # largest deviation of a point on the reference's path, m or rad


@dataclass(frozen=True, slots=True)
class TaskPlan:
    """Configured references of a task."""

    task: Task
    weight: float  # of the enabled task
    enabled: bool  # at activation
    setpoint_duration: float  # s


@dataclass(frozen=True, slots=True)
class ContactPlan:
    """Configured state of a contact."""

    enabled: bool  # at activation
    ramp: float  # duration of loading or unloading, s
    contact: Contact

    @property
    def capacity(self) -> float:
        """Largest normal force on the robot, N."""
        if self.contact.internal:
            return 0.0
        return self.contact.max_normal_force if isinstance(self.contact, UnilateralContact) else math.inf


@dataclass(frozen=True, slots=True)
class BoardPlan:
    """Plans of all tasks and contacts."""

    tasks: Mapping[str, TaskPlan]
    contacts: Mapping[str, ContactPlan]
    weight_ramp: float  # for weights, gains and limits, s
    tuning: Tuning
    robot_weight: float = 0.0  # to be carried by the contacts, N; 0 for a fixed base


class ReferenceBoard:
    """Trajectories and ramps of all references; sets of changes are applied completely or not at all."""

    #: Saved state.
    STATE_FIELDS = (
        "forces", "_tuning", "_weights", "_enabled", "_weight_ramps", "_contact_ramps", "slipping", "_friction_ramps",
        "_anchors", "_trajectories", "_goals", "_wrenches",
    )  # fmt: skip
    SAMPLE_CACHE = ("_constant_references", "_settled_ramps")  # samples, which follow from the saved state

    def __init__(self, plan: BoardPlan) -> None:
        self.plans = plan.tasks
        self.contact_plans = plan.contacts
        self._weight_ramp, self._robot_weight = plan.weight_ramp, plan.robot_weight
        #: Present force of each active contact, (k,) in N and N·m; updated before changes are applied.
        self.forces: Mapping[str, Array] = {}
        self._tuning = TuningRamp.at(plan.tuning)
        self._weights = {name: plan.weight for name, plan in self.plans.items()}
        self._enabled = {name: plan.enabled for name, plan in self.plans.items()}
        self._weight_ramps = dict.fromkeys(self.plans, SoftRamp(0.0, 0.0, 0.0, 0.0))
        self._contact_ramps = dict.fromkeys(self.contact_plans, SoftRamp(0.0, 0.0, 0.0, 0.0))
        self.slipping: tuple[str, ...] = ()
        self._friction_ramps = dict.fromkeys(self.contact_plans, SoftRamp(0.0, 0.0, 1.0, 1.0))
        self._anchors: Mapping[str, Array] = {}
        self._trajectories: dict[str, Trajectory] = {}
        self._goals: dict[str, SetSetpoint | SetTrajectory] = {}  # of disabled tasks
        self._wrenches: dict[str, Array] = {}
        self._ranges: dict[str, PositionRange] = {}  # computed at first use
        self._discard_samples()

    def _discard_samples(self) -> None:
        # Times from which references are constant: all of them, and those with ramps.
        self._constant_references: tuple[float, References] | None = None
        self._settled_ramps: tuple[float, References] | None = None

    def reset(self, dynamics: Dynamics, time: float) -> None:
        """Hold the present state, with configured contacts anchored at their present pose."""
        self._discard_samples()
        for name, plan in self.plans.items():
            self._enabled[name] = plan.enabled
            self._weights[name] = plan.weight
            weight = plan.weight if plan.enabled else 0.0
            self._weight_ramps[name] = SoftRamp(time, 0.0, weight, weight)
            self._trajectories[name] = _hold(rest_of(plan.task, dynamics), time)
            self._range_of(name, dynamics)
        for name, contact in self.contact_plans.items():
            self._contact_ramps[name] = SoftRamp(time, 0.0, 0.0, float(contact.enabled))
            self._friction_ramps[name] = SoftRamp(time, 0.0, 1.0, 1.0)
            self._anchor(name, dynamics)
        self.forces = {}
        self.slipping = ()
        self._goals.clear()
        self._wrenches.clear()
        self._tuning = TuningRamp.at(self._tuning.after)

    def replan(self, plan: BoardPlan, dynamics: Dynamics, time: float | None) -> None:
        """Replace the plan, with ramps; without `time` at once."""
        self._discard_samples()
        before, contacts_before = self.plans, self.contact_plans
        self.plans, self.contact_plans, self._weight_ramp = plan.tasks, plan.contacts, plan.weight_ramp
        if time is None:
            self._tuning = TuningRamp.at(plan.tuning)
            return
        self._tuning = self._tuning.towards(plan.tuning, time, plan.weight_ramp)
        for name, task in plan.tasks.items():
            if task.weight != before[name].weight:
                self._apply(SetWeight(name, task.weight), dynamics, time)
            if task.enabled != before[name].enabled:
                self._apply(EnableTask(name, task.enabled), dynamics, time)
        for name, contact in plan.contacts.items():
            if contact.enabled != contacts_before[name].enabled:
                self._apply(EnableContact(name, contact.enabled), dynamics, time)

    def apply(self, changes: Iterable[Change], dynamics: Dynamics, time: float) -> None:
        """Apply a set of changes at a time, s, or raise `InputRefused` as `check`, without any change."""
        changes = tuple(changes)
        for change in changes:
            self.check(change, dynamics, time)
        for change in changes:
            self._apply(change, dynamics, time)

    def check(self, change: Change, dynamics: Dynamics, time: float) -> None:
        """Check a change; refuses a trajectory in the past, and a setpoint or first point out of range."""
        if isinstance(change, SetSetpoint):
            position = self._in_task_frame(change, dynamics, time).position
        elif isinstance(change, SetTrajectory):
            end = (time if change.start is None else change.start) + change.points[-1].time
            if end < time:
                raise InputRefused(
                    f"trajectory for task {change.task!r} ended {time - end:.3f} s ago on the clock of the states "
                    "(header.stamp 0 means: start now)"
                )
            position = change.points[0].position
        else:
            return
        check_position(self.plans[change.task].task, position, self._range_of(change.task, dynamics), dynamics)

    def _range_of(self, task: str, dynamics: Dynamics) -> PositionRange:
        if task not in self._ranges:
            self._ranges[task] = position_range(self.plans[task].task, dynamics.model)
        return self._ranges[task]

    def _apply(self, change: Change, dynamics: Dynamics, time: float) -> None:
        if isinstance(change, SetSetpoint | SetTrajectory):
            self._constant_references = None  # ramps do not change
            placed = self._in_task_frame(change, dynamics, time) if isinstance(change, SetSetpoint) else change
            self._follow(placed, time)
            return
        self._discard_samples()
        if isinstance(change, SetWeight):
            self._weights[change.task] = change.weight
            self._ramp_weight(change.task, time)
        elif isinstance(change, EnableTask):
            self._enable(change.task, change.enabled, dynamics, time)
        elif isinstance(change, EnableContact):
            name, plan = change.contact, self.contact_plans[change.contact]
            before, goal = self._activations(time)[name], float(change.enabled)
            if change.enabled and before <= 0.0:
                self._anchor(name, dynamics)
            duration = plan.ramp if change.ramp is None else change.ramp
            if not change.enabled and duration > 0.0 and name in self.forces:
                before = min(before, needed_activation(plan.contact, self.forces[name]))
            self._contact_ramps[name] = SoftRamp(time, duration, before, goal)
        elif isinstance(change, SetSlippingContacts):
            for name, ramp in self._friction_ramps.items():
                if name in change.contacts and name not in self.slipping:
                    self._friction_ramps[name] = ramp.towards(_SLIPPING_FRICTION, time, _REDUCTION)
                elif name in self.slipping and name not in change.contacts:
                    self._friction_ramps[name] = ramp.towards(1.0, time, _RECOVERY)
            self.slipping = tuple(change.contacts)
        elif isinstance(change, SetExternalWrench):
            self._wrenches[change.frame] = change.wrench

    def _activations(self, time: float) -> dict[str, float]:
        """Return the activation of all contacts, from 0 to 1.

        Contacts that are being unloaded keep a total bound of the weight less the bounds of the other contacts.
        """
        ramps = self._contact_ramps
        activations = {name: ramp.sample(time) for name, ramp in ramps.items()}
        unloading = [name for name, ramp in ramps.items() if ramp.after <= 0.0 < activations[name]]
        if unloading and self._robot_weight > 0.0:
            plans = self.contact_plans
            bounds = {name: share * plans[name].capacity for name, share in activations.items() if share}
            own = sum(bounds[name] for name in unloading)
            missing = self._robot_weight - (sum(bounds.values()) - own)
            for name in unloading if own < missing else ():
                activations[name] = min(ramps[name].before, activations[name] * missing / own)
        return activations

    def anchor_slipping_contacts(self, dynamics: Dynamics) -> None:
        """Anchor slipping contacts at their present pose, so that they do not return."""
        for name in self.slipping:
            self._discard_samples()
            self._anchor(name, dynamics)

    def _anchor(self, name: str, dynamics: Dynamics) -> None:
        contact = self.contact_plans[name].contact
        if isinstance(contact, AnchoredContact) and contact.stiffness > 0.0:
            self._anchors = frozen_mapping({**self._anchors, name: anchor_of(contact, dynamics)})

    def _in_task_frame(self, change: SetSetpoint, dynamics: Dynamics, time: float) -> SetSetpoint:
        if not change.frame:
            return change
        form, goal = self.plans[change.task].task.form, self._goal(change.task, dynamics, time)
        position = in_world(change.task, change.frame, change.position, goal, form, dynamics)
        return replace(change, position=position, frame="")

    def _goal(self, task: str, dynamics: Dynamics, time: float) -> Array:
        stored = self._goals.get(task)
        if stored is not None:
            return stored.position if isinstance(stored, SetSetpoint) else stored.points[-1].position
        if self._is_inactive(task, time):
            return rest_of(self.plans[task].task, dynamics).position
        return self._trajectories[task].knots[-1].position

    def _follow(self, change: SetSetpoint | SetTrajectory, time: float) -> None:
        if isinstance(change, SetTrajectory) and change.start is None:
            change = replace(change, start=time)
        if not self._enabled[change.task]:
            self._goals[change.task] = change
        if not self._is_inactive(change.task, time):
            self._trajectories[change.task] = self._joined_trajectory(change, time)

    def _enable(self, task: str, enabled: bool, dynamics: Dynamics, time: float) -> None:
        """Enable or disable a task; an inactive one starts at the present state and moves to its goal."""
        if enabled:
            goal = self._goals.pop(task, None)
            if self._is_inactive(task, time):
                self._trajectories[task] = _hold(rest_of(self.plans[task].task, dynamics), time)
                if goal is not None:
                    self._trajectories[task] = self._joined_trajectory(goal, time)
        self._enabled[task] = enabled
        self._ramp_weight(task, time)

    def _is_inactive(self, task: str, time: float) -> bool:
        return not self._enabled[task] and self._weight_ramps[task].sample(time) <= 0.0

    def _ramp_weight(self, task: str, time: float) -> None:
        target = self._weights[task] if self._enabled[task] else 0.0
        self._weight_ramps[task] = self._weight_ramps[task].towards(target, time, self._weight_ramp)

    def _towards(self, task: str, position: Array, time: float, duration: float | None = None) -> Trajectory:
        still = np.zeros(len(self._trajectories[task].knots[0].velocity))
        duration = self.plans[task].setpoint_duration if duration is None else duration
        if duration < _SHORTEST_MOVE:
            return Trajectory([Knot(time, position, still, still)])
        return Trajectory([self.present(task, time), Knot(time + duration, position, still, still)])

    def _joined_trajectory(self, goal: SetSetpoint | SetTrajectory, time: float) -> Trajectory:
        """Join the present reference to a setpoint or to the future points of a trajectory.

        Points that require a jump are skipped: past ones, and ones off the path less than `_SHORTEST_JOIN` ahead.
        """
        if isinstance(goal, SetSetpoint):
            return self._towards(goal.task, goal.position, time, goal.duration)
        present = self.present(goal.task, time)
        start = time if goal.start is None else goal.start
        ahead = [replace(point, time=start + point.time) for point in goal.points if start + point.time > time]
        while ahead and ahead[0].time - time < _SHORTEST_JOIN and _deviates(present, ahead[0]):
            ahead.pop(0)
        if not ahead:
            return self._towards(goal.task, goal.points[-1].position, time)
        return Trajectory([present, *ahead])

    def present(self, task: str, time: float) -> Knot:
        """Return the reference of a task at a time in s."""
        reference = self._trajectories[task].sample(time)
        return Knot(time, reference.position, reference.velocity, reference.acceleration)

    def sample(self, time: float) -> References:
        """Return all references at a time in s; unchanged parts are the same objects."""
        if self._constant_references is not None and time >= self._constant_references[0]:
            return self._constant_references[1]
        references = self._sample_all(time)
        if self._settled_ramps is not None:
            at_rest = max([self._settled_ramps[0], *(each.knots[-1].time for each in self._trajectories.values())])
            if time >= at_rest:
                self._constant_references = at_rest, references
        return references

    def _sample_all(self, time: float) -> References:
        tasks = {name: trajectory.sample(time) for name, trajectory in self._trajectories.items()}
        if self._settled_ramps is not None and time >= self._settled_ramps[0]:
            return replace(self._settled_ramps[1], tasks=tasks)
        references = References(
            tasks=tasks,
            weights=MappingProxyType({name: ramp.sample(time) for name, ramp in self._weight_ramps.items()}),
            contacts=MappingProxyType(self._activations(time)),
            external_wrenches=dict(self._wrenches),
            tuning=self._tuning.sample(time),
            anchors=self._anchors,
            friction=MappingProxyType({name: ramp.sample(time) for name, ramp in self._friction_ramps.items()}),
        )
        ramps = [self._tuning.share, *self._weight_ramps.values(), *self._contact_ramps.values()]
        settled = max(ramp.start + ramp.duration for ramp in (*ramps, *self._friction_ramps.values()))
        self._settled_ramps = (settled, references) if time >= settled else None
        return references


def _deviates(present: Knot, knot: Knot) -> bool:
    n = min(len(present.position), len(present.velocity))
    there = present.position[:n] + (knot.time - present.time) * present.velocity[:n]
    return bool(np.abs(knot.position[:n] - there).max() > _LARGEST_DEVIATION)


def _hold(reference: Reference, time: float) -> Trajectory:
    return Trajectory([Knot(time, reference.position, reference.velocity, reference.acceleration)])
