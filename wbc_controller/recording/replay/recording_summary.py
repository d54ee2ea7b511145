"""Summary of a recording, of its replay, and of a cycle."""

import datetime
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from wbc_controller.controller.cycle import ControlCycle
from wbc_controller.controller.visualization.tables import Table, as_text
from wbc_controller.errors import ConfigurationError
from wbc_controller.inverse_dynamics.references import changes
from wbc_controller.recording.cycle_layout import AGES, MODES
from wbc_controller.recording.recorder import software_versions
from wbc_controller.recording.recording_file import Recording
from wbc_controller.recording.replay.cycle_replay import Replay, ReplayedCycle
from wbc_controller.records import ChangeSettings

_SHOWN = 25  # lines at each end of the history


def summarize(recorded: Recording) -> str:
    """Summarize a recording: duration, software, faults, requests and modes."""
    lines = [
        f"{recorded.path}: {recorded.about['robot']}, {recorded.count} cycles in "
        f"{recorded.elapsed(recorded.end):.3f} s (cycles {recorded.first} to {recorded.last}), from "
        f"{clock_time(recorded.start)}"
    ]
    missing = recorded.last - recorded.first + 1 - recorded.count
    if missing:
        lines.append(f"{missing} cycles were dropped: the recorder was too slow, or the disk was full")
    if recorded.damage:
        lines.append(f"the file is damaged, read up to there: {recorded.damage}")
    here = software_versions()
    lines += [
        f"recorded with {name} {version}, replayed with {here.get(name, 'none')}: the last bits of torques may differ"
        for name, version in recorded.about["software"].items()
        if here.get(name) != version
    ]
    for cycle, fault in recorded.faults.items():
        at = recorded.events[cycle]["time"]
        when = f"at {recorded.elapsed(at):.3f} s ({clock_time(at)})"
        lines.append(f"fault {fault.code} in cycle {cycle}, {when}: {fault.sentence}")
    if not recorded.faults:
        lines.append("no fault")
    history = _history(recorded)
    if len(history) > 2 * _SHOWN:
        history[_SHOWN:-_SHOWN] = [f"{'…':>12}  {len(history) - 2 * _SHOWN} more"]
    return "\n".join([*lines, "", *history])


def replay_all(recorded: Recording) -> tuple[str, bool]:
    """Replay all cycles; return a summary, and False without cycles or if a cycle differs that must be identical."""
    run = Replay(recorded)
    count, different, worst, exact, first = 0, 0, 0.0, True, ""
    for solved in run.run():
        count += 1
        if not solved.is_identical:
            different += 1
            worst, exact = max(worst, solved.difference), exact and not solved.exact
            first = first or f"the first is cycle {solved.cycle.number} at {recorded.elapsed(solved.cycle.time):.3f} s"
    text = ""
    if run.skipped:
        text = f"{run.skipped} cycles skipped: their requests or the controller's memory before them are not recorded\n"
    if not different:
        return f"{text}{count} cycles replayed: all torques are equal bit for bit", count > 0
    reason = "" if not exact else " (the solver does not expose its warm start: only whole recordings are exact)"
    return f"{text}{count} cycles replayed: {different} differ, by up to {worst:.3g} N·m; {first}{reason}", exact


def replay_cycle(recorded: Recording, number: int) -> str:
    """Replay and explain a cycle; one that cannot be replayed raises `ConfigurationError`."""
    if not recorded.first <= number <= recorded.last:
        raise ConfigurationError(f"--cycle {number}: valid: {recorded.first} to {recorded.last}")
    run = Replay(recorded)
    for solved in run.run(number, number):
        if solved.cycle.number == number:
            return explain_cycle(solved, recorded, run.controller)
    known = recorded.memory_after(number)
    raise ConfigurationError(
        f"--cycle {number}: the cycle or the controller's memory before it is not recorded; "
        + (f"valid: from {known} on" if known is not None else "no later cycle can be replayed")
    )


def explain_cycle(solved: ReplayedCycle, recorded: Recording, controller: ControlCycle) -> str:
    """Explain a cycle: inputs, solution with binding constraints, supervisor."""
    cycle, result = solved.cycle, solved.result
    event: Mapping[str, Any] = recorded.events.get(cycle.number, {})
    heading = f"cycle {cycle.number} at {recorded.elapsed(cycle.time):.3f} s: {result!r}"
    ages = [(name, cycle.scalar(f"age/{name}")) for name in AGES]
    seconds = cycle.scalar("seconds/total")
    replayed = "equal bit for bit" if solved.is_identical else f"differs by up to {solved.difference:.3g} N·m"
    memory, limits = controller.memory()["supervisor"], controller.supervisor.limits
    facts = [
        ("mode in the recording", MODES[int(cycle.scalar("mode"))].value),
        ("replay result", replayed),
        ("time in this mode", f"{cycle.scalar('now') - memory['_since']:.3f} s"),
        ("share of the solution's torques", f"{memory['_share'].sample(cycle.scalar('now')):.3f}"),
        ("largest torque rate", f"{limits.torque_rate:g} effort limits per second"),
        ("time without a solution", _budget(memory["_held_time"], limits.safety.hold_time)),
        ("time with relaxed constraints", _budget(memory["_relaxed_time"], limits.safety.relax_time)),
        ("time of the cycle", f"{1e3 * seconds:.3f} ms" if np.isfinite(seconds) else "unknown"),
    ]
    if result.command is not None and result.solution is not None:
        cut = float(np.max(np.abs(result.command.tau - result.solution.tau)))
        facts.append(("largest torque change by the supervisor", f"{cut:.3g} N·m"))
    tables = [
        Table(("supervisor", ""), tuple(facts)),
        Table(("residual of the program", ""), tuple((n, f"{v:.2e}") for n, v in result.residuals.items())),
        Table(("age of an input", ""), tuple((n, f"{1e3 * age:.2f} ms") for n, age in ages if not np.isnan(age))),
        Table(("in this cycle", ""), tuple(_event_texts(event))),
    ]
    return as_text(heading, tables)


def _budget(memory: Mapping[str, Any], limit: float) -> str:
    return f"{memory['_total']:.3f} s (limit {limit:g} s)"


def clock_time(time: int) -> str:
    """Format a time in ns as date and time, or as simulated time."""
    if time < 10**17:  # before 1973
        return f"{1e-9 * time:.3f} s of simulated time"
    return datetime.datetime.fromtimestamp(1e-9 * time).astimezone().strftime("%Y-%m-%d %H:%M:%S.%f %Z")


def _history(recorded: Recording) -> list[str]:
    lines, mode = [], ""
    for number, event in sorted(recorded.events.items()):
        words = [f"{kind} {text}" for kind, text in _event_texts(event) if kind != "problem"]
        if event["mode"] != mode or words:
            at = f"{recorded.elapsed(event['time']):.3f} s"
            lines.append(f"{at:>12}  cycle {number:<8} {event['mode']:<9} {'; '.join(words)}".rstrip())
            mode = event["mode"]
    return lines


def _event_texts(event: Mapping[str, Any]) -> list[tuple[str, str]]:
    words = [("command", str(word)) for word in event.get("requests", ())]
    words += [("change", _TEXTS.get(type(change), str)(change)) for each in event.get("changes", ()) for change in each]
    words += [("refused", str(sentence)) for sentence in event.get("refused", ())]
    words += [("dropped", f"{count} messages on {topic}") for topic, count in event.get("left out", {}).items()]
    if "settings" in event:
        words.append(("settings", "changed"))
    for kind in ("problem", "fault"):
        if event.get(kind) is not None:
            words.append((kind, f"{event[kind].code}: {event[kind].sentence}"))
    return words


def _describe_setpoint(change: changes.SetSetpoint) -> str:
    where = f" in {change.frame}" if change.frame else ""
    return f"setpoint of {change.task}: {np.array2string(change.position, precision=3, threshold=8)}{where}"


def _describe_walk(change: changes.Walk) -> str:
    v = change.velocity
    return "walking stops" if v is None else f"walk at {v[0]:g}, {v[1]:g} m/s and {v[2]:g} rad/s"


#: Text of each kind of change.
_TEXTS: Mapping[type, Callable[[Any], str]] = {
    changes.SetSetpoint: _describe_setpoint,
    changes.SetTrajectory: lambda change: f"trajectory of {change.task}: {len(change.points)} points",
    changes.SetWeight: lambda change: f"weight of {change.task}: {change.weight:g}",
    changes.EnableTask: lambda change: f"task {change.task} {'on' if change.enabled else 'off'}",
    changes.EnableContact: lambda change: f"contact {change.contact} {'on' if change.enabled else 'off'}",
    changes.SetSlippingContacts: lambda change: f"slipping contacts: {', '.join(change.contacts) or 'none'}",
    changes.SetExternalWrench: lambda change: (
        f"external wrench at {change.frame}: {np.array2string(change.wrench, precision=3)}"
    ),
    changes.Walk: _describe_walk,
    changes.WalkTo: lambda change: "walk to {:g}, {:g} m and {:g} rad".format(*change.pose),
    changes.WalkFootsteps: lambda change: f"walk by {len(change.poses)} footsteps",
    ChangeSettings: lambda change: f"settings: {dict(change.settings)}",
}
