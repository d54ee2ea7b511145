"""Report as one HTML file, with its plots."""

from pathlib import Path

import numpy as np

from wbc_controller.controller.cycle import ControlCycle
from wbc_controller.controller.visualization import plots as style
from wbc_controller.controller.visualization.page_report import PageReport, Plot, ResultTable, write_page
from wbc_controller.controller.visualization.plots import Line, Panel, Series, by_category, line_panels
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.recording.recording_file import Recording
from wbc_controller.recording.report.motion import make_motion
from wbc_controller.recording.report.run_data import RunData, make_run_data
from wbc_controller.records import Array

MIN_LOAD_SHARE = 0.05  # of the largest normal force; below it the use of friction is noise
DRAWN_JOINTS = 6  # with separate torque lines
NO_TRUTH_NOTE = "The recording does not contain the true contact forces and the targets of a demo."


def run_plots(run: RunData) -> list[Plot]:
    """Return all plots with data."""
    plots = [_com(run), _torques(run)]
    if run.contact_wrenches:
        plots += [_forces(run), _friction(run)]
    if run.task_errors:
        plots.append(_errors(run))
    if run.audit:
        plots.append(_audit(run))
    if len(run.cycle_seconds):
        plots.append(_cycles(run))
        if run.stage_seconds:
            plots.append(_stages(run))
    return plots


def friction_use(wrench: Array, coefficient: float) -> Array:
    """Return the use of the friction cone, |f_t| / (μ f_z), (n,), from (n, k); NaN at small loads."""
    normal = wrench[:, 2]
    borne = normal > MIN_LOAD_SHARE * np.nanmax(normal, initial=0.0)
    use = np.full(len(wrench), np.nan)
    use[borne] = np.linalg.norm(wrench[borne, :2], axis=1) / (coefficient * normal[borne])
    return use


def _com(run: RunData) -> Plot:
    panels = []
    for i, axis in enumerate("xyz"):
        com = Line("centre of mass", run.time, run.com[:, i], style.BLUE)
        reference = Line("reference", run.time, run.com_reference[:, i], style.ORANGE, dash="dash", width=1.4)
        panels.append(Panel(f"{axis} [m]", [com, reference], span=0.02))
    return _over_time(run, "com", "Centre of mass", "Position in the world, and its reference.", panels, 500)


def _torques(run: RunData) -> Plot:
    use = 100.0 * np.abs(run.tau) / run.effort_limits  # (n, na) in %
    peaks = np.max(np.nan_to_num(use), axis=0, initial=0.0)  # (na,)
    lines = [Line("largest of all joints", run.time, use.max(axis=1, initial=0.0), style.GREY, width=0.8, filled=True)]
    for joint, color in zip(np.argsort(-peaks)[:DRAWN_JOINTS], style.PALETTE, strict=False):
        lines.append(Line(run.actuators[joint].removesuffix("_joint"), run.time, use[:, joint], color, width=1.2))
    caption = "Joints with the largest torques, and the envelope of all joints. Dotted: effort limit."
    panel = Panel("|torque| / limit [%]", lines, range=(0.0, 108.0), limit=100.0)
    return _over_time(run, "torques", "Torques as a share of their limits", caption, [panel], 330)


def _forces(run: RunData) -> Plot:
    panels = []
    for name, wrench in run.contact_wrenches.items():
        lines = []
        if name in run.true_wrenches:  # below the other line
            true = run.true_wrenches[name][:, 2]
            lines.append(Line("force of the ground", run.time, true, style.ORANGE, width=1.2))
        lines.append(Line("force in the QP", run.time, wrench[:, 2], style.BLUE))
        panels.append(Panel(f"{name.replace('_', ' ')}<br>f<sub>z</sub> [N]", lines, from_zero=True))
    truth = ", and true force of the ground," if run.true_wrenches else ""
    caption = f"Force in the solution of the quadratic program{truth} along each contact's normal."
    return _over_time(run, "forces", "Vertical contact forces", caption, panels, 110 + 145 * len(panels))


def _friction(run: RunData) -> Plot:
    lines = []
    for i, (name, coefficient) in enumerate(run.friction.items()):  # a fixed contact has no friction cone
        color = style.PALETTE[i % len(style.PALETTE)]
        label = f"{name.replace('_', ' ')} (μ = {coefficient:g})"
        lines.append(Line(label, run.time, friction_use(run.contact_wrenches[name], coefficient), color))
        if name in run.true_wrenches:
            use = friction_use(run.true_wrenches[name], coefficient)
            lines.append(Line("ground", run.time, use, color, group=label, width=1.0, dash="dot"))
    caption = "Solid: in the QP; dotted: of the ground. " if run.true_wrenches else "Of the forces in the QP. "
    caption += f"At 1 a contact slips. Hidden below {MIN_LOAD_SHARE:.0%} of the largest load."
    panel = Panel("|f<sub>t</sub>| / (μ f<sub>z</sub>) [1]", lines, from_zero=True, limit=1.0)
    return _over_time(run, "friction", "Use of friction", caption, [panel], 300)


def _errors(run: RunData) -> Plot:
    lines = [Line(name.replace("_", " "), run.time, error) for name, error in run.task_errors.items()]
    caption = "Norm of each task's error, in m for positions and rad for orientations."
    panel = Panel("error [m or rad]", lines, from_zero=True)
    return _over_time(run, "errors", "Task errors", caption, [panel], 280)


def _audit(run: RunData) -> Plot:
    force = Line("force on the centre of mass", run.time, run.audit["force"], style.RED)
    energy = Line("energy residual", run.time, run.audit["energy"], style.PALETTE[4])
    caption = "Forces and power that the model does not explain: zero without disturbance."
    panels = [Panel("force [N]", [force], from_zero=True), Panel("power [W]", [energy])]
    return _over_time(run, "audit", "Model audit", caption, panels, 360)


def _cycles(run: RunData) -> Plot:
    milliseconds = 1.0e3 * run.cycle_seconds
    median, p99, most = np.percentile(milliseconds, [50.0, 99.0, 99.8])
    end = max(1.05 * most, 1.25 * median)  # the last bin contains all longer cycles
    counts, edges = np.histogram(np.minimum(milliseconds, end), bins=70, range=(0.0, end))
    share = 100.0 * counts / len(milliseconds)
    top = np.array([0.0, share.max()])
    lines = [
        Line(f"{len(milliseconds):,} cycles", np.repeat(edges, 2)[1:-1], np.repeat(share, 2), style.BLUE, filled=True),
        Line(f"median {median:.2f} ms", np.full(2, median), top, style.GREEN, dash="dash"),
        Line(f"99th percentile {p99:.2f} ms", np.full(2, p99), top, style.ORANGE, dash="dash"),
    ]
    figure = line_panels([Panel("share of cycles [%]", lines)], height=320, axis="time of one control cycle [ms]")
    late = int((milliseconds > end).sum())
    caption = f"Slowest: {milliseconds.max():.2f} ms."
    caption += f" The last bin contains {late} longer cycles." if late else ""
    return Plot("cycles", "Cycle times", caption, figure)


def _stages(run: RunData) -> Plot:
    names = [name.replace("_", " ") for name in run.stage_seconds]
    median, p99 = (
        [1.0e3 * float(np.nanpercentile(seconds, share)) for seconds in run.stage_seconds.values()]
        for share in (50.0, 99.0)
    )
    series = [
        Series("median", names, median, style.BLUE, "bar", [f"{value:.3f} ms" for value in median]),
        Series("99th percentile", names, p99, style.ORANGE, "line-ns", [f"{value:.3f} ms" for value in p99]),
    ]
    figure = by_category(series, axis="time in one cycle [ms]")
    return Plot("stages", "Stages of a cycle", "Duration of each stage.", figure)


def _over_time(run: RunData, key: str, title: str, caption: str, panels: list[Panel], height: int) -> Plot:
    figure = line_panels(panels, height=height, shaded=[(start, end) for start, end, _ in run.spans[1::2]])
    figure.update_xaxes(range=[float(run.time[0]), float(run.time[-1])])
    return Plot(key, title, caption, figure, over_time=True)


def report_recording(recording: Recording, path: Path) -> str:
    """Write the report of a recording, and return its notes; errors of `make_run_data` and `write_run_report`."""
    controller = ControlCycle(recording.config, preflight=False)
    run = make_run_data(recording, controller)
    notes = [] if run.true_wrenches else [NO_TRUTH_NOTE]
    if run.stride > 1:
        notes.append(f"One of {run.stride} cycles is shown.")
    if recording.damage:
        notes.append(f"The recording is damaged, read up to there: {recording.damage}.")
    write_run_report(run, controller.model, path, kind="wbc_controller recording", note=" ".join(notes))
    return " ".join(notes)


def write_run_report(run: RunData, model: RobotModel, path: Path, *, kind: str, note: str = "") -> None:
    """Write the report of a run, with `kind` above the robot's name and `note` below the verdict.

    Errors as for `make_motion` and `write_page`.
    """
    missed = [result.name for result in run.results if not result.passed]
    rows = [((each.name, each.target, each.measured), each.passed) for each in run.results]
    verdict = f"All {len(rows)} targets met." if rows else "No targets were checked in this run."
    if missed:
        verdict = f"{len(missed)} of {len(rows)} targets missed: {', '.join(missed)}."
    facts = {"Simulated" if run.true_wrenches else "Recorded": f"{run.duration:.1f} s"}
    facts["Actuators"] = str(len(run.actuators))
    if len(run.cycle_seconds):
        median, p99 = 1.0e3 * np.percentile(run.cycle_seconds, [50.0, 99.0])
        facts |= {"Control cycles": f"{len(run.cycle_seconds):,}", "Median cycle": f"{median:.2f} ms"}
        facts |= {"99th percentile": f"{p99:.2f} ms"}
    report = PageReport(
        title=run.robot,
        kind=kind,
        verdict=verdict,
        passed=not missed if rows else None,
        note=note,
        facts=facts,
        motion=make_motion(run, model),
        table=ResultTable("Results", ("Check", "Target", "Measured"), rows) if rows else None,
        plots=run_plots(run),
        footer="Click in a plot to show the motion at that time. Drag to zoom in, double-click to zoom out.",
    )
    write_page(report, path)
