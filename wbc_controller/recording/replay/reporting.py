"""The demo's report, of any recording: what only a simulation knows is left out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from wbc_controller.controller.cycle import ControlCycle
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.inverse_dynamics.tasks import AccelerationTask, Task
from wbc_controller.recording.columns import AUDIT_COLUMNS, audited, columns
from wbc_controller.recording.reading import Cycle, Recorded
from wbc_controller.recording.report.report import write_report
from wbc_controller.recording.report.run_record import Event, Recording, supports_of, vertical_on_base
from wbc_controller.records import Array, Reference
from wbc_controller.settings import ComTask, FixedContact, PointContact, RollingContact

#: Most cycles in a report: of a longer recording every second, third, … is taken.
_MOST = 30_000
#: What a recording of the controller does not hold.
LEFT_OUT = (
    "Made from the controller's recording. Left out, as the controller cannot know it: the forces that the ground "
    "really gave, and the targets of a demo."
)


def report(recorded: Recorded, path: Path) -> None:
    """Write the report of a recording as one HTML file.

    Args:
        recorded: the recording.
        path: of the file.

    Raises:
        ConfigurationError: where no command was sent, or the file cannot be written.
    """
    controller = ControlCycle(recorded.config, preflight=False)
    made, every = recording_of(recorded, controller)
    note = LEFT_OUT + (f" Of {every} cycles one is shown." if every > 1 else "")
    if recorded.torn:
        note += f" The recording breaks off: {recorded.torn}."
    try:
        write_report(made, controller.model, path, kind="wbc_controller recording", note=note)
    except OSError as error:
        raise ConfigurationError(f"the report {path}: cannot be written: {error.strerror or error}") from error


def recording_of(recorded: Recorded, controller: ControlCycle) -> tuple[Recording, int]:
    """What the report is made from, and of how many cycles one was taken.

    Raises:
        ConfigurationError: where no command was sent.
    """
    table = columns(recorded)
    if not table or not np.isfinite(table["q"]).all(axis=1).any():
        raise ConfigurationError(f"recording {recorded.path}: there is nothing to report: no command was sent")
    every = -(-recorded.count // _MOST)
    model, settings, tasks = controller.model, controller.config.settings, controller.tasks
    com = next((name for name, task in settings.tasks.items() if isinstance(task, ComTask)), None)
    dynamics = Dynamics(model)
    rows: dict[str, list[Array]] = {}
    errors: dict[str, list[float]] = {name: [] for name, task in tasks.items() if isinstance(task, AccelerationTask)}
    for cycle in _shown(recorded, every):
        values = cycle.values
        dynamics.update(np.array(values["q"]), np.array(values["v"]))
        rows.setdefault("q", []).append(values["q"])
        rows.setdefault("tau", []).append(values["tau"])
        rows.setdefault("com", []).append(np.array(dynamics.com))
        wanted = np.full(3, np.nan)
        if com is not None and cycle.references and cycle.references[f"weight/{com}"][0] > 0.0:
            wanted = cycle.references[f"position/{com}"]
        rows.setdefault("com_reference", []).append(wanted)
        stamp = cycle.number_of("stamp_seconds") + 1e-9 * cycle.number_of("stamp_nanoseconds")
        rows.setdefault("time", []).append(np.array(stamp))
        rows.setdefault("at", []).append(np.array(float(cycle.time)))
        rows.setdefault("audit", []).append(audited(cycle))
        unmodelled = vertical_on_base(model, np.array(values["q"]), values["disturbance"])
        rows.setdefault("unmodelled", []).append(np.array(unmodelled))
        for name, contact in settings.contacts.items():
            wrench = controller.contacts[name].basis @ values[f"force/{name}"]
            size = 3 if isinstance(contact, PointContact | RollingContact) else 6
            rows.setdefault(f"wrench/{name}", []).append(wrench[:size])
        for name, series in errors.items():
            series.append(_error(cycle, name, tasks[name], dynamics))
    found = {name: np.array(values) for name, values in rows.items()}
    start = found["time"][0]
    times = np.maximum.accumulate(found["time"] - start)

    def shown(at: int) -> float:
        """A time of the recording on the time of the report, s."""
        return float(np.interp(float(at), found["at"], times))

    total = table["seconds/total"]
    modes = [str(mode) for mode in table["mode"]]
    changes = [i for i, mode in enumerate(modes) if i == 0 or mode != modes[i - 1]]
    return (
        Recording(
            robot=str(recorded.about["robot"]),
            actuators=model.actuators,
            time=times,
            q=found["q"],
            tau=found["tau"],
            effort_limits=model.effort_limits,
            com=found["com"],
            com_reference=found["com_reference"],
            frame_errors={name: np.array(series) for name, series in errors.items() if np.isfinite(series).any()},
            contact_wrenches={name: found[f"wrench/{name}"] for name in settings.contacts},
            unmodelled=found["unmodelled"],
            true_wrenches={},
            friction={
                name: each.friction for name, each in settings.contacts.items() if not isinstance(each, FixedContact)
            },
            cycle_seconds=total,
            stage_seconds={
                stage: table[f"seconds/{stage}"]
                for stage in ("read", "compute", "supervise", "write")
                if np.isfinite(table[f"seconds/{stage}"]).all()
            },
            events=tuple(_events(recorded, shown)),
            results=(),
            modes=tuple((max(0.0, 1e-9 * float(table["stamp"][i]) - float(start)), modes[i]) for i in changes),
            supports=supports_of(settings.contacts),
            audit=dict(zip(AUDIT_COLUMNS, found["audit"].T, strict=True)),
        ),
        every,
    )


def _shown(recorded: Recorded, every: int) -> Iterator[Cycle]:
    """Each cycle that is shown: with a state and a command."""
    for i, cycle in enumerate(recorded.cycles()):
        if i % every == 0 and cycle.number_of("has_state") and cycle.number_of("has_command"):
            yield cycle


def _error(cycle: Cycle, name: str, task: Task, dynamics: Dynamics) -> float:
    """Norm of a task's error; NaN where the task is off, or its reference is not known."""
    wanted = cycle.references
    if not wanted or not wanted[f"weight/{name}"][0] > 0.0 or not isinstance(task, AccelerationTask):
        return float("nan")
    reference = Reference(*(np.array(wanted[f"{kind}/{name}"]) for kind in ("position", "velocity", "acceleration")))
    _, error = task.right(dynamics, reference)
    return float(np.linalg.norm(error))


def _events(recorded: Recorded, shown: Callable[[int], float]) -> Iterator[Event]:
    """The phases between commands and faults."""
    for _, event in sorted(recorded.events.items()):
        words = [str(word) for word in event.get("requests", ())]
        if event.get("fault") is not None:
            words.append(event["fault"].code)
        if words:
            yield Event(shown(event["time"]), ", ".join(words))
