"""Layout of a recorded cycle."""

import operator
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from wbc_controller.controller.memory import CycleRecord
from wbc_controller.controller.report import CycleReport
from wbc_controller.inverse_dynamics.arrays import consecutive
from wbc_controller.inverse_dynamics.contacts import Contact
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.tasks import Task
from wbc_controller.records import Array, Mode, Reference, References

FORMAT = 15  # version of recordings; other versions are rejected
MODES = tuple(Mode)
AGES = ("joint_states", "odom", "imu", "base estimate")  # recorded ages and stage times
STAGES = (
    "read", "compute", "compute/build", "compute/solve", "compute/unpack", "supervise", "write", "total", "audit",
)  # fmt: skip
#: First numbers of every cycle, all finite.
HEAD = (
    "number", "now", "stamp_seconds", "stamp_nanoseconds", "mode", "has_state", "has_joint_velocity", "has_command",
    "has_solution", "has_references", "same_state", "has_event", "fault", "iterations", "relaxed", "deadlines_missed",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Slot:
    """Named numbers of a cycle."""

    group: str
    name: str
    size: int


def cycle_slots(model: RobotModel, contacts: Mapping[str, Contact]) -> tuple[Slot, ...]:
    """Return the slots of every cycle of a controller."""
    slots = [Slot("cycle", name, 1) for name in HEAD]
    slots += [Slot("cycle", f"age/{name}", 1) for name in AGES]
    slots += [Slot("cycle", f"seconds/{name}", 1) for name in STAGES]
    slots += [Slot("cycle", f"audit/{name}", 1) for name in ("energy", "throughput", "warnings")]
    slots += [Slot("cycle", "audit/force", 3), Slot("cycle", "audit/torques", model.nj)]
    slots += [Slot("state", "q", model.nq), Slot("state", "v", model.nv), Slot("state", "joint_velocity", model.nj)]
    slots += [Slot("state", f"touching/{name}", 1) for name in contacts]
    slots += [Slot("torques", "tau", model.na)]
    slots += [Slot("solution", "v_dot", model.nv), Slot("solution", "tau_wanted", model.na)]
    slots.append(Slot("solution", "disturbance", model.nv))
    slots += [Slot("solution", f"force/{name}", contact.size) for name, contact in contacts.items()]
    return tuple(slots)


def reference_slots(tasks: Mapping[str, Task], contacts: Mapping[str, Contact]) -> tuple[Slot, ...]:
    """Return the slots of the references."""
    slots = [Slot("references", "number", 1)]
    for name, task in tasks.items():
        sizes = {"position": task.form.size, "velocity": task.form.rate_size, "acceleration": task.form.rate_size}
        slots += [Slot("references", f"{part}/{name}", size) for part, size in sizes.items()]
    slots += [Slot("references", f"weight/{name}", 1) for name in tasks]
    slots += [Slot("references", f"contact/{name}", 1) for name in contacts]
    return tuple(slots)


def slot_slices(slots: Sequence[Slot]) -> Iterator[tuple[Slot, slice]]:
    """Return each slot with its place in a row."""
    return zip(slots, consecutive(slot.size for slot in slots), strict=True)


def split(slots: Sequence[Slot], row: Array) -> dict[str, Array]:
    """Split a row by slot name."""
    return {slot.name: row[place] for slot, place in slot_slices(slots)}


class CycleRow:
    """Writer of cycle rows, with NaN for absent numbers."""

    def __init__(self, slots: Sequence[Slot]) -> None:
        self._places = {slot.name: place for slot, place in slot_slices(slots)}
        self._empty = np.full(sum(slot.size for slot in slots), np.nan)

    def write(self, number: int, record: CycleRecord, report: CycleReport | None, *, same: bool, event: bool) -> Array:
        """Return the row of a cycle.

        Args:
            report: None for a cycle that was repeated before its command was sent.
            same: True if the state is that of the previous cycle.
            event: True if an event follows, which a killed process may not record.
        """
        result, inputs = record.result, record.inputs
        state, velocity = inputs.state, inputs.joint_velocity
        command, solution = result.command, result.solution
        stamp = 0 if state is None else state.stamp
        numbers: dict[str, Any] = {
            "number": number,
            "now": inputs.now,
            "stamp_seconds": stamp // 1_000_000_000,
            "stamp_nanoseconds": stamp % 1_000_000_000,
            "mode": MODES.index(result.mode),
            "has_state": state is not None,
            "has_joint_velocity": velocity is not None,
            "has_command": command is not None,
            "has_solution": solution is not None,
            "has_references": result.references is not None,
            "same_state": same,
            "has_event": event,
            "fault": result.fault is not None,
            "iterations": 0 if solution is None else solution.iterations,
            "relaxed": 0 if solution is None else len(solution.relaxed),
            "deadlines_missed": 0 if report is None else report.deadlines_missed,
            "audit/warnings": 0,
        }
        stages = result.stage_seconds
        if report is not None:
            stages = report.stage_seconds
            numbers |= {f"age/{name}": age for name, age in report.inputs.ages.items() if name in AGES}
            if (audit := report.audit) is not None:
                numbers |= {"audit/energy": audit.energy, "audit/throughput": audit.throughput}
                numbers |= {"audit/force": audit.force, "audit/torques": audit.joint_torques}
                numbers["audit/warnings"] = len(audit.warnings)
        numbers |= {f"seconds/{name}": seconds for name, seconds in stages.items() if name in STAGES}
        if state is not None:
            numbers |= {"q": state.q, "v": state.v}
        if velocity is not None:
            numbers["joint_velocity"] = velocity
        numbers |= {f"touching/{name}": pressed for name, pressed in inputs.touching.items()}
        if command is not None:
            numbers["tau"] = command.tau
        if solution is not None:
            disturbance = 0.0 if solution.disturbance is None else solution.disturbance.forces
            numbers |= {"v_dot": solution.v_dot, "tau_wanted": solution.tau, "disturbance": disturbance}
            numbers |= {f"force/{name}": force for name, force in solution.forces.items()}
        row: Array = self._empty.copy()
        for name, value in numbers.items():
            row[self._places[name]] = value
        return row


class ReferencesRow:
    """Writer of changed references, repeated after `every` cycles for the last seconds."""

    def __init__(self, every: int) -> None:
        self._every = every
        self._due = 0
        self._tasks: list[Reference] = []
        self._weights: list[float] = []

    def write(self, number: int, references: References) -> Array | None:
        """Return the row of the references, or None if unchanged."""
        tasks = [*references.tasks.values()]
        weights = [*references.weights.values(), *references.contacts.values()]
        if number < self._due and weights == self._weights and all(map(operator.is_, tasks, self._tasks)):
            return None
        self._due, self._tasks, self._weights = number + self._every, tasks, weights
        parts: list[Any] = [[number]]
        for each in tasks:
            parts += (each.position, each.velocity, each.acceleration)
        row: Array = np.concatenate([*parts, weights])
        return row
