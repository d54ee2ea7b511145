"""What the numbers of a recorded cycle are: groups, each a topic with an array of doubles, and slots in these."""

from __future__ import annotations

import operator
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from wbc_controller.controller.memory import Taped
from wbc_controller.inverse_dynamics.whole_body_qp import WholeBodyQP
from wbc_controller.records import Array, CycleReport, Mode, Reference, References

#: Version of the layout; another one is not read.
FORMAT = 4
MODES = tuple(Mode)
#: Inputs whose ages are recorded, stages whose times are, and results of the audit.
AGES = ("joint_states", "odom", "imu", "base estimate")
STAGES = (
    "read", "compute", "compute/build", "compute/solve", "compute/unpack", "supervise", "write", "total", "audit",
)  # fmt: skip
_HEAD = (
    "number", "now", "stamp_seconds", "stamp_nanoseconds", "mode", "has_state", "has_joint_velocity", "has_command",
    "has_solution", "has_references", "same_state", "has_event", "fault", "iterations", "relaxed", "deadlines_missed",
)  # fmt: skip
_NAN = float("nan")
_NOTHING = (_NAN,) * max(len(AGES), len(STAGES))


@dataclass(frozen=True, slots=True)
class Slot:
    """Some numbers of a cycle.

    Attributes:
        group: the topic that they are on.
        name: what they are.
        size: how many.
    """

    group: str
    name: str
    size: int


def layout_of(qp: WholeBodyQP) -> tuple[Slot, ...]:
    """The numbers of every cycle of one controller."""
    model = qp.model
    slots = [Slot("cycle", name, 1) for name in _HEAD]
    slots += [Slot("cycle", f"age/{name}", 1) for name in AGES]
    slots += [Slot("cycle", f"seconds/{name}", 1) for name in STAGES]
    slots += [Slot("cycle", f"audit/{name}", 1) for name in ("energy", "throughput", "warnings")]
    slots += [Slot("cycle", "audit/force", 3), Slot("cycle", "audit/torques", model.nj)]
    slots += [Slot("state", "q", model.nq), Slot("state", "v", model.nv), Slot("state", "joint_velocity", model.nj)]
    slots += [Slot("torques", "tau", model.na)]
    slots += [Slot("solution", "v_dot", model.nv), Slot("solution", "tau_wanted", model.na)]
    slots.append(Slot("solution", "disturbance", model.nv))
    slots += [Slot("solution", f"force/{name}", contact.size) for name, contact in qp.contacts.items()]
    return tuple(slots)


def references_of(qp: WholeBodyQP, references: Mapping[str, Reference]) -> tuple[Slot, ...]:
    """The numbers of the references of a cycle, which are recorded when they change.

    Args:
        qp: the program.
        references: of any cycle, for their sizes.
    """
    slots = [Slot("references", "number", 1)]
    for name, reference in references.items():
        slots.append(Slot("references", f"position/{name}", len(reference.position)))
        slots.append(Slot("references", f"velocity/{name}", len(reference.velocity)))
        slots.append(Slot("references", f"acceleration/{name}", len(reference.acceleration)))
    slots += [Slot("references", f"weight/{name}", 1) for name in qp.tasks]
    slots += [Slot("references", f"contact/{name}", 1) for name in qp.contacts]
    return tuple(slots)


def groups(slots: Sequence[Slot]) -> Iterator[tuple[str, int, int]]:
    """Each group with the places of its first number and behind its last one; groups stand together."""
    at, name, start = 0, slots[0].group, 0
    for slot in slots:
        if slot.group != name:
            yield name, start, at
            name, start = slot.group, at
        at += slot.size
    yield name, start, at


def dumped(slots: Sequence[Slot]) -> list[list[Any]]:
    """The slots for JSON."""
    return [[slot.group, slot.name, slot.size] for slot in slots]


class Row:
    """Writes the numbers of one cycle, in the order of the layout."""

    def __init__(self, qp: WholeBodyQP, slots: Sequence[Slot]) -> None:
        self._head = struct.Struct(f"<{sum(slot.size == 1 and slot.group == 'cycle' for slot in slots)}d")
        model = qp.model
        sizes = {slot.name: slot.size for slot in slots}
        nothing = {size: np.full(size, _NAN) for size in {*sizes.values()}}
        self._state = (nothing[model.nq], nothing[model.nv])
        self._joints, self._tau = np.full(model.nj, _NAN), np.full(model.na, _NAN)
        self._v_dot = nothing[model.nv]
        self._no_disturbance = np.zeros(model.nv)
        self._forces = {name: nothing[contact.size] for name, contact in qp.contacts.items()}
        self._no_ages = _NOTHING[: len(AGES)]
        self._no_audit = (_NAN, _NAN, 0.0)
        self._no_force = np.full(3, _NAN)

    def write(self, number: int, taped: Taped, report: CycleReport | None, same: bool, event: bool) -> bytes:
        """The numbers of a cycle as bytes.

        Args:
            number: of the cycle.
            taped: what it was given, and gave.
            report: of the loop; None for a cycle that was computed anew before it was sent.
            same: whether its state is that of the cycle before, the very object.
            event: whether it has an event, which comes after it: a process that is killed may not get to that.
        """
        result, state, velocity = taped.result, taped.state, taped.joint_velocity
        command, solution, references = result.command, result.solution, result.references
        stamp = 0 if state is None else state.stamp
        head = [
            number, taped.now, stamp // 1_000_000_000, stamp % 1_000_000_000, MODES.index(result.mode),
            state is not None, velocity is not None, command is not None, solution is not None, references is not None,
            same, event, result.fault is not None, 0.0 if solution is None else solution.iterations,
            0.0 if solution is None else len(solution.relaxed), 0.0 if report is None else report.deadlines_missed,
        ]  # fmt: skip
        stages = result.stage_seconds if report is None else report.stage_seconds
        head += self._no_ages if report is None else map(report.ages.get, AGES, _NOTHING)
        head += map(stages.get, STAGES, _NOTHING)
        audit = None if report is None else report.audit
        head += self._no_audit if audit is None else (audit.energy, audit.throughput, len(audit.warnings))
        parts: list[Any] = [self._head.pack(*head)]
        parts += (self._no_force, self._joints) if audit is None else (audit.force, audit.joint_torques)
        parts += self._state if state is None else (state.q, state.v)
        parts.append(self._joints if velocity is None else velocity)
        parts.append(self._tau if command is None else command.tau)
        if solution is None:
            parts += [self._v_dot, self._tau, self._v_dot, *self._forces.values()]
        else:
            beside = solution.disturbance
            parts += [solution.v_dot, solution.tau, self._no_disturbance if beside is None else beside.forces]
            forces = solution.forces
            parts += map(forces.get, self._forces, self._forces.values())
        return b"".join(parts)


class ReferencesRow:
    """Writes the references of a cycle when they are other ones, and from time to time."""

    def __init__(self, every: int) -> None:
        """Make it.

        Args:
            every: number of cycles after which they are written again, so that the last seconds have them too.
        """
        self._every = every
        self._due = 0
        self._tasks: list[Reference] = []
        self._shares: list[float] = []

    def write(self, number: int, references: References) -> bytes | None:
        """The references of a cycle as bytes; None where they are those that were written last."""
        tasks = [*references.tasks.values()]
        shares = [*references.weights.values(), *references.contacts.values()]
        if number < self._due and shares == self._shares and all(map(operator.is_, tasks, self._tasks)):
            return None
        self._due, self._tasks, self._shares = number + self._every, tasks, shares
        parts: list[Any] = [np.array([float(number)])]
        for each in tasks:
            parts += (each.position, each.velocity, each.acceleration)
        return b"".join([*parts, np.array(shares).tobytes()])


def split(slots: Sequence[Slot], row: Array) -> dict[str, Array]:
    """The numbers of a cycle by slot."""
    ends = np.cumsum([slot.size for slot in slots])
    return {slot.name: row[end - slot.size : end] for slot, end in zip(slots, ends.tolist(), strict=True)}
