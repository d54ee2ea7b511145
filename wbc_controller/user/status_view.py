"""What `wbc status` shows: mode, rates, ages, tasks, what binds, and the audit, from the topics of the nodes."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from wbc_controller.settings import Settings
from wbc_controller.wire.setpoints import JOINT_FIELDS

_COLOURS = {0: "green", 1: "yellow", 2: "red"}


def status_view(
    settings: Settings,
    status: Any,
    rate: float,
    tasks: Mapping[str, tuple[Any | None, Any | None]],
    guard: str,
) -> RenderableType:
    """Draw the state of a controller.

    Args:
        settings: of the robot.
        status: the controller's diagnostic_msgs/DiagnosticStatus.
        rate: cycles per second of wall time; NaN where it is not known yet.
        tasks: messages of the value and the reference of each task, by name.
        guard: what the guard says; empty where there is none.
    """
    values = {value.key: value.value for value in status.values}
    return Group(
        Text(f"{status.hardware_id}: {status.message}", style=f"bold {_COLOURS.get(_level(status), 'red')}"),
        _facts(values, rate, guard),
        _task_table(settings, values, tasks),
        *(
            Text(f"{key}: {value}")
            for key, value in values.items()
            if key.startswith(("infeasibility/", "publishers/"))
        ),
    )


def _level(status: Any) -> int:
    level = status.level  # a byte, which some codecs give as such
    return level[0] if isinstance(level, bytes | bytearray) else int(level)


def _facts(values: Mapping[str, str], rate: float, guard: str) -> Table:
    table = Table.grid(padding=(0, 2))
    late = values.get("deadlines_missed", "0")
    cycles = f"{rate:.0f} per second" if np.isfinite(rate) else "counting"
    table.add_row("cycles", cycles + (f", {late} deadlines missed" if late != "0" else ""))
    if "time/total/median" in values:
        table.add_row("cycle time", f"median {values['time/total/median']}, at most {values['time/total/max']}")
    ages = [f"{key.removeprefix('age/')} {_milliseconds(value)}" for key, value in values.items() if "age/" in key]
    table.add_row("ages", ", ".join(ages))
    table.add_row("guard", guard or "none is heard")
    if "binding" in values:
        table.add_row("binding", values["binding"])
    audit = [
        f"{key.removeprefix('audit/').replace('_', ' ')} {value}"
        for key, value in values.items()
        if key.startswith("audit/")
    ]
    if audit:
        table.add_row("audit", "; ".join(audit))
    return table


def _milliseconds(age: str) -> str:
    seconds = float(age.partition(" ")[0])
    return f"{1e3 * seconds:.1f} ms" if np.isfinite(seconds) else "never"


def _task_table(
    settings: Settings, values: Mapping[str, str], tasks: Mapping[str, tuple[Any | None, Any | None]]
) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for column in ("task", "type", "weight", "value", "reference", "error"):
        table.add_column(column, overflow="fold", justify="right" if column in ("weight", "error") else "left")
    for name, task in settings.tasks.items():
        weight = values.get(f"task_weight/{name}")
        off = weight is not None and float(weight) <= 0.0
        value, reference = tasks.get(name, (None, None))
        table.add_row(
            name,
            task.type,
            "" if weight is None else "off" if off else weight,
            "" if value is None else numbers(value, task.type),
            "" if reference is None or off else numbers(reference, task.type),
            "" if off else values.get(f"task_error/{name}", ""),
            style="dim" if off else "",
        )
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
