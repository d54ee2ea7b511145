"""What `wbc status` shows: mode, rates, ages, tasks, what binds, and the audit, from the topics of the nodes."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from wbc_controller.apps.terminal.next_step import next_step
from wbc_controller.middleware.setpoints import JOINT_FIELDS
from wbc_controller.nodes.diagnostics.shortfall import in_words
from wbc_controller.settings import Settings

#: Of the levels of a status.
_COLOURS = {0: "green", 1: "yellow", 2: "red"}


@dataclass(frozen=True, slots=True)
class Heard:
    """What the nodes of a robot have said last.

    Attributes:
        status: the controller's diagnostic_msgs/DiagnosticStatus.
        rate: cycles per second of wall time; NaN where it is not known yet.
        tasks: messages of the value and the reference of each task, by name.
        guard: what the guard says; empty where there is none.
    """

    status: Any
    rate: float
    tasks: Mapping[str, tuple[Any | None, Any | None]]
    guard: str

    @property
    def values(self) -> dict[str, str]:
        """The values of the status, by key."""
        return {value.key: value.value for value in self.status.values}

    @property
    def level(self) -> int:
        """0 where all is well, 1 for a warning, 2 for an error."""
        level = self.status.level  # a byte, which some codecs give as such
        return level[0] if isinstance(level, bytes | bytearray) else int(level)


def status_view(settings: Settings, heard: Heard) -> RenderableType:
    """Draw the state of a controller."""
    values = heard.values
    table = Table.grid(padding=(0, 2))
    for row in facts(heard):
        table.add_row(*row)
    return Group(
        Text(f"{heard.status.hardware_id}: {heard.status.message}", style=f"bold {_COLOURS.get(heard.level, 'red')}"),
        table,
        _task_table(settings, heard),
        *(
            Text(f"{key}: {value}")
            for key, value in values.items()
            if key.startswith(("infeasibility/", "publishers/"))
        ),
    )


def facts(heard: Heard) -> list[tuple[str, str]]:
    """What there is to know beside the mode and the tasks: names, and texts."""
    values, found = heard.values, []
    late = values.get("deadlines_missed", "0")
    cycles = f"{heard.rate:.0f} per second" if np.isfinite(heard.rate) else "counting"
    found.append(("cycles", cycles + (f", {late} deadlines missed" if late != "0" else "")))
    if "time/total/median" in values:
        found.append(("cycle time", f"median {values['time/total/median']}, at most {values['time/total/max']}"))
    ages = [f"{key.removeprefix('age/')} {_milliseconds(value)}" for key, value in values.items() if "age/" in key]
    found.append(("ages", ", ".join(ages)))
    found.append(("guard", heard.guard or "none is heard"))
    if "binding" in values:
        found.append(("binding", ", ".join(in_words(name) for name, _ in binding(values)) or "none"))
    audit = [
        f"{key.removeprefix('audit/').replace('_', ' ')} {value}"
        for key, value in values.items()
        if key.startswith("audit/")
    ]
    if audit:
        found.append(("audit", "; ".join(audit)))
    if "recorder" in values:
        found.append(("recorder", values["recorder"]))
    advice = next_step(heard.status.message)
    if advice:
        found.append(("next", advice))
    return found


def binding(values: Mapping[str, str]) -> list[tuple[str, str]]:
    """The binding constraints with their multipliers, those with the largest first."""
    costs = [(key.removeprefix("cost/"), value) for key, value in values.items() if key.startswith("cost/")]
    return sorted(costs, key=lambda cost: -float(cost[1].partition(" ")[0]))


def _milliseconds(age: str) -> str:
    seconds = float(age.partition(" ")[0])
    return f"{1e3 * seconds:.1f} ms" if np.isfinite(seconds) else "never"


@dataclass(frozen=True, slots=True)
class TaskRow:
    """One task in words; what is not known, or does not matter while it is off, is empty."""

    name: str
    kind: str
    weight: str
    value: str
    reference: str
    error: str
    off: bool


def task_rows(settings: Settings, heard: Heard) -> list[TaskRow]:
    """What is known of each task."""
    rows, values = [], heard.values
    for name, task in settings.tasks.items():
        weight = values.get(f"task_weight/{name}")
        off = weight is not None and float(weight) <= 0.0
        value, reference = heard.tasks.get(name, (None, None))
        rows.append(
            TaskRow(
                name,
                task.type,
                "" if weight is None else "off" if off else weight,
                "" if value is None else numbers(value, task.type),
                "" if reference is None or off else numbers(reference, task.type),
                "" if off else values.get(f"task_error/{name}", ""),
                off,
            )
        )
    return rows


def _task_table(settings: Settings, heard: Heard) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for column in ("task", "type", "weight", "value", "reference", "error"):
        table.add_column(column, overflow="fold", justify="right" if column in ("weight", "error") else "left")
    for row in task_rows(settings, heard):
        cells = (row.name, row.kind, row.weight, row.value, row.reference, row.error)
        table.add_row(*cells, style="dim" if row.off else "")
    return table


def numbers(content: Any, kind: str) -> str:
    """The numbers of a setpoint, a reference or a value, in short."""
    if kind in JOINT_FIELDS:
        joints: Sequence[float] = getattr(content, JOINT_FIELDS[kind])
        return f"{len(joints)} joints"
    parts = []
    if hasattr(content, "pose"):
        if kind != "frame_orientation":
            parts.append(_listed(content.pose.position, "xyz"))
        parts.append("quaternion " + _listed(content.pose.orientation, "xyzw"))
    elif hasattr(content, "wrench"):
        parts += [_listed(content.wrench.force, "xyz"), _listed(content.wrench.torque, "xyz")]
    else:
        parts.append(_listed(content.point if hasattr(content, "point") else content.vector, "xyz"))
    return " ".join(parts)


def _listed(vector: Any, axes: str) -> str:
    return re.sub(r"-(0\.0*)(?= |$)", r"\1", " ".join(f"{getattr(vector, axis):.3f}" for axis in axes))
