"""Panels of the page as HTML."""

import math
from collections.abc import Iterable, Sequence
from html import escape

import numpy as np

from wbc_controller.apps.page.snapshot import Robot, Snapshot
from wbc_controller.apps.terminal.status_view import RobotStatus, binding, facts, next_step, task_rows
from wbc_controller.controller.visualization.scene import friction_used
from wbc_controller.inverse_dynamics.contacts import UnilateralContact
from wbc_controller.nodes.diagnostics.task_reports import describe_constraint
from wbc_controller.records import Array

#: Colours of the modes.
_MODES = {"active": "#2f9e44", "holding": "#e8890c", "damping": "#e8590c", "fault": "#e03131", "stopped": "#e03131"}
_NO_MODE, _SILENT = "#868e96", "#e03131"
_ORANGE_SHARE, _RED_SHARE = 0.7, 0.95  # shares of a limit for an orange and a red bar
_SILENCE_TIMEOUT = 1.5  # without states or status, wall time, s
_MAX_BINDING = 8  # largest number of binding constraints shown

STYLE = """<style>
.wbc { font-size: 12.5px; line-height: 1.45; padding: 2px 10px 8px; overflow-wrap: anywhere; }
.wbc h4 { margin: 12px 0 3px; font-size: 11px; letter-spacing: .06em; text-transform: uppercase; opacity: .6; }
.wbc .mode { display: inline-block; color: #fff; font-weight: 700; font-size: 15px; border-radius: 5px;
  padding: 2px 11px; margin: 4px 8px 4px 0; text-transform: uppercase; letter-spacing: .04em; }
.wbc .why { margin: 4px 0; padding: 6px 9px; border-left: 3px solid; border-radius: 3px; background: #8881; }
.wbc table { width: 100%; border-collapse: collapse; font-variant-numeric: tabular-nums; }
.wbc td, .wbc th { padding: 1.5px 4px 1.5px 0; text-align: left; vertical-align: top; font-weight: 400; }
.wbc th { opacity: .6; font-size: 11px; } .wbc .n { text-align: right; white-space: nowrap; }
.wbc td.key { opacity: .6; white-space: nowrap; padding-right: 8px; overflow-wrap: normal; }
.wbc tr.off { opacity: .45; } .wbc .muted { opacity: .6; }
.wbc .bar { position: relative; height: 9px; min-width: 92px; background: #8882; border-radius: 2px; margin-top: 4px; }
.wbc .bar i { position: absolute; top: 0; bottom: 0; border-radius: 2px; }
.wbc .bar b { position: absolute; left: 50%; top: -1px; bottom: -1px; width: 1px; background: #8888; }
</style>"""


def controller_panel(robot: Robot, snapshot: Snapshot) -> str:
    """Return mode, binding constraints, tasks and loop."""
    status = snapshot.status
    if status is None:
        return _page([_mode(snapshot)])
    return _page([_mode(snapshot), _binding(status), _tasks(robot, status), _loop(status)])


def torque_panel(robot: Robot, snapshot: Snapshot) -> str:
    """Return torques with their limits, and friction of the contacts."""
    return _page([_contacts(robot, snapshot), _torques(robot, snapshot)])


def effort_shares(robot: Robot, joint_torques: Array) -> Array:
    """Return the actuator torques as shares of their limits, (na,)."""
    return np.asarray(robot.model.actuation.from_joints(joint_torques) / robot.model.effort_limits)


def _page(parts: Iterable[str]) -> str:
    return f'{STYLE}<div class="wbc">{"".join(parts)}</div>'


def _mode(snapshot: Snapshot) -> str:
    mode, _, rest = snapshot.mode.partition(" ")
    color = _MODES.get(mode, _NO_MODE)
    lines = []
    silent = snapshot.silence > _SILENCE_TIMEOUT
    if silent:
        color = _SILENT
        since = "" if math.isinf(snapshot.silence) else f" for {snapshot.silence:.0f} s"
        lines.append((f"No status of the controller{since}.", "Start the controller (wbc run), or read its log."))
    if snapshot.age > _SILENCE_TIMEOUT:
        since = "No joint states yet." if math.isinf(snapshot.age) else f"No joint states for {snapshot.age:.0f} s."
        lines.append((since, "Check that the robot or wbc mock runs in this DDS domain."))
    message = "" if silent or snapshot.status is None else snapshot.status.status.message
    warnings = [part for part in message.split("; ")[1:] if not rest or part not in rest]
    if rest:
        lines.append((rest, next_step(rest)))
        warnings = [part for part in warnings if part.partition(":")[0] not in rest]
    lines += [(warning, "") for warning in warnings]
    if not snapshot.base_measured:
        lines.append(("No topic contains the pose of the base; the robot is drawn standing on its contacts.", ""))
    rows = "".join(
        f'<div class="why" style="border-color:{color}">{escape(text)}'
        + (f'<br><span class="muted">Next: {escape(advice)}</span>' if advice else "")
        + "</div>"
        for text, advice in lines
    )
    return f'<span class="mode" style="background:{color}">{escape(mode or "no controller")}</span>{rows}'


def _binding(status: RobotStatus) -> str:
    found = binding(status.values)
    if not found:
        return '<h4>Binding constraints</h4><span class="muted">none</span>'
    most = max(_leading(cost) for _, cost in found) or 1.0
    rows = "".join(
        f"<tr><td>{escape(_plain(describe_constraint(name)))}</td>"
        f"<td>{_bar(_leading(cost) / most, color='#7950f2')}</td>"
        f'<td class="n muted">{escape(cost)}</td></tr>'
        for name, cost in found[:_MAX_BINDING]
    )
    more = f'<tr><td class="muted">and {len(found) - _MAX_BINDING} more</td></tr>' if len(found) > _MAX_BINDING else ""
    return f'<h4>Binding constraints and their cost</h4><table class="binding">{rows}{more}</table>'


def _tasks(robot: Robot, status: RobotStatus) -> str:
    rows = ""
    for row in task_rows(robot.settings, status):
        task = robot.tasks[row.name]
        size = float(row.error or 0.0)
        error = f"{size:.4f}" if size < 1.0 else f"{size:.3g}"
        error = f"{error} {escape(getattr(task, 'unit', ''))}" if row.error else ""
        off = ' class="off"' if row.off else ""
        cells = f'<td>{escape(row.name)}</td><td class="n">{escape(row.weight)}</td><td class="n">{error}</td>'
        rows += f"<tr{off}>{cells}</tr>"
    return f'<h4>Tasks</h4><table><tr><th>task</th><th class="n">weight</th><th class="n">error</th></tr>{rows}</table>'


def _loop(status: RobotStatus) -> str:
    rows = "".join(
        f'<tr><td class="key">{escape(name)}</td><td>{escape(text)}</td></tr>'
        for name, text in facts(status).items()
        if name not in ("binding", "next")
    )
    return f"<h4>Loop and audit</h4><table>{rows}</table>"


def _contacts(robot: Robot, snapshot: Snapshot) -> str:
    if not snapshot.forces:
        return '<h4>Contacts</h4><span class="muted">no forces; the controller is inactive</span>'
    used = friction_used(robot.contacts, snapshot.forces, robot.model.mass * robot.model.gravity)
    rows = ""
    for name, force in snapshot.forces.items():
        contact = robot.contacts[name]
        if isinstance(contact, UnilateralContact):
            bar = _bar(used[name]) if used[name] >= 0.0 else '<span class="muted">not loaded</span>'
            size = f"{force[contact.normal]:.0f} N"
        else:
            bar, size = "", f"{np.linalg.norm(force[:3]):.0f} N"
        rows += f'<tr><td>{escape(name)}</td><td class="n">{size}</td><td>{bar}</td></tr>'
    head = '<tr><th>contact</th><th class="n">normal force</th><th>friction used</th></tr>'
    return f"<h4>Contacts</h4><table>{head}{rows}</table>"


def _torques(robot: Robot, snapshot: Snapshot) -> str:
    if snapshot.torques is None:
        return '<h4>Torques and limits</h4><span class="muted">no torques</span>'
    shares = effort_shares(robot, snapshot.torques)
    taus = np.round(shares * robot.model.effort_limits, 1) + 0.0  # no minus zero
    rows = "".join(
        f'<tr><td>{escape(_plain(name))}</td><td class="n">{tau:.1f}</td><td>{_bar(share, signed=True)}</td></tr>'
        for name, tau, share in zip(robot.model.actuators, taus.tolist(), shares.tolist(), strict=True)
    )
    head = '<tr><th></th><th class="n">N·m</th><th>share of limit</th></tr>'
    return f"<h4>Torques and limits</h4><table>{head}{rows}</table>"


def _bar(share: float, *, signed: bool = False, color: str = "") -> str:
    size = min(1.0, abs(share))
    color = color or ("#e03131" if size >= _RED_SHARE else "#f08c00" if size >= _ORANGE_SHARE else "#228be6")
    width = 100.0 * size / (2.0 if signed else 1.0)
    left = 50.0 - (width if share < 0.0 else 0.0) if signed else 0.0
    middle = "<b></b>" if signed else ""
    return f'<div class="bar">{middle}<i style="left:{left:.1f}%;width:{width:.1f}%;background:{color}"></i></div>'


def _leading(cost: str) -> float:
    return abs(float(cost.partition(" ")[0]))


def _plain(name: str) -> str:
    """Shorten ``left_knee_joint's upper torque limit`` to ``left knee's …``."""
    return name.replace("_joint", "").replace("_", " ")


def request_list(lines: Sequence[tuple[str, bool]]) -> str:
    """Return the requests, newest first, refused ones in red."""
    if not lines:
        return _page(['<span class="muted">none</span>'])
    return _page(
        f'<div style="{"" if done else "color:#e03131;"}font-family:monospace;font-size:11px">{escape(text)}</div>'
        for text, done in lines
    )
