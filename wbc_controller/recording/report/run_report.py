"""Report as one HTML file."""

from pathlib import Path

import numpy as np

from wbc_controller.controller.cycle import ControlCycle
from wbc_controller.controller.visualization.page_report import PageReport, ResultTable, write_page
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.recording.recording_file import Recording
from wbc_controller.recording.report.motion import make_motion
from wbc_controller.recording.report.run_data import RunData, make_run_data
from wbc_controller.recording.report.run_plots import run_plots

NO_TRUTH_NOTE = "The recording does not contain the true contact forces and the targets of a demo."


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
