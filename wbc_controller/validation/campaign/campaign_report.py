"""Report of a campaign."""

import csv
import json
import shlex
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import chain, cycle, groupby
from pathlib import Path

import numpy as np
from rich import box
from rich.table import Table
from scipy import stats

from wbc_controller.controller.visualization.page_report import PageReport, Plot, ResultTable, write_page
from wbc_controller.controller.visualization.plots import GREY, PALETTE, Series, by_category
from wbc_controller.errors import ConfigurationError
from wbc_controller.extras import require_libraries
from wbc_controller.validation.campaign.results import VIOLATIONS, Outcome, TrialKey
from wbc_controller.validation.campaign.trial import ALL_KINDS

_COLUMNS = (
    "kind", "robot", "trials", "survived", "share (95 %)", "damped for", "to detect", "detected after [ms]",
    "deadline [ms]", "violations",
)  # fmt: skip
#: Colours of the outcomes, in the order of the bars.
_COLORS = {
    "survived": "#22a06b",
    "STALE_INPUT": "#2f7de1",
    "ESTIMATE_LOST": "#c2569f",
    "IMPLAUSIBLE_STATE": "#8a63d2",
    "UNEXPLAINED_MOTION": "#a33b3b",
    "FALLING": "#f2b05e",
    "FALLEN": "#e5812b",
    "NO_SOLUTION": "#b58900",
    "RELAXED": "#149eb0",
    "BAD_TORQUE": "#7d8794",
    "CLOCK": "#4a4f9c",
    "ESTOP": "#b06a3b",
}
_VIOLATION = "#d6455d"


@dataclass(frozen=True, slots=True)
class Row:
    """Trials of one kind of fault on one robot: a row of the CSV file."""

    place: str
    kind: str
    robot: str
    trials: int
    survived: int
    share_low: float  # Wilson's 95 % interval of the share of survived trials
    share_high: float
    reasons: dict[str, int]  # by fault code
    must_be_detected: int  # trials with a deadline
    detected_median_s: float | None
    detected_max_s: float | None
    deadline_max_s: float | None
    violations: dict[str, int]  # trials by name


def rows_of(outcomes: Sequence[Outcome]) -> list[Row]:
    """Return the trials by kind and robot."""
    order = list(ALL_KINDS)

    def place(outcome: Outcome) -> tuple[int, str]:
        return order.index(outcome.kind), outcome.robot

    return [_row(list(group)) for _, group in groupby(sorted(outcomes, key=place), place)]


def _row(group: Sequence[Outcome]) -> Row:
    survived = sum(not outcome.code for outcome in group)
    low, high = stats.binomtest(survived, len(group)).proportion_ci(0.95, method="wilson")
    deadlines = [outcome.deadline for outcome in group if outcome.deadline is not None]
    delays = [outcome.after for outcome in group if outcome.deadline is not None and outcome.after is not None]
    return Row(
        place=ALL_KINDS[group[0].kind].place,
        kind=group[0].kind,
        robot=group[0].robot,
        trials=len(group),
        survived=survived,
        share_low=float(low),
        share_high=float(high),
        reasons=dict(Counter(outcome.code for outcome in group if outcome.code).most_common()),
        must_be_detected=len(deadlines),
        detected_median_s=float(np.median(delays)) if delays else None,
        detected_max_s=max(delays, default=None),
        deadline_max_s=max(deadlines, default=None),
        violations=dict(Counter(name for outcome in group for name in outcome.violations)),
    )


def _cells(row: Row) -> tuple[str, ...]:
    delays = f"{_milliseconds(row.detected_median_s)} (max {_milliseconds(row.detected_max_s)})"
    return (
        row.kind,
        row.robot,
        str(row.trials),
        str(row.survived),
        f"{row.survived / row.trials:.2f} ({row.share_low:.2f}–{row.share_high:.2f})",
        _counts_text(row.reasons),
        str(row.must_be_detected),
        delays if row.detected_max_s is not None else "–",
        _milliseconds(row.deadline_max_s),
        _counts_text(row.violations),
    )


def _milliseconds(seconds: float | None) -> str:
    return "–" if seconds is None else f"{1e3 * seconds:.0f}"


def _counts_text(counts: dict[str, int]) -> str:
    return ", ".join(f"{name} {number}" for name, number in counts.items()) or "–"


def terminal_table(outcomes: Sequence[Outcome]) -> Table:
    """Return the table for a terminal."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    for column in _COLUMNS:
        text = column in ("kind", "robot", "damped for", "violations")
        table.add_column(column, justify="left" if text else "right", no_wrap=column in ("kind", "robot"))
    for row in rows_of(outcomes):
        table.add_row(*_cells(row), style="red" if row.violations else None)
    return table


def summary(outcomes: Sequence[Outcome]) -> str:
    """Return a summary in one sentence."""
    kinds, robots = {outcome.kind for outcome in outcomes}, {outcome.robot for outcome in outcomes}
    survived = sum(not outcome.code for outcome in outcomes)
    bad = sum(bool(outcome.violations) for outcome in outcomes)
    must_detect = [outcome for outcome in outcomes if outcome.deadline is not None]
    detected = sum("undetected" not in outcome.violations for outcome in must_detect)
    longest = max(outcome.longest for outcome in outcomes)
    return (
        f"{len(outcomes)} trials, {len(kinds)} kinds of fault, {len(robots)} robots: {survived} survived, "
        f"{len(outcomes) - survived} damped; {detected} of {len(must_detect)} faults with a deadline were detected "
        f"in time; {bad} trials with violations; longest cycle {1e3 * longest:.1f} ms of processor time"
    )


def repetitions(outcomes: Sequence[Outcome], before: Mapping[TrialKey, Outcome]) -> list[str]:
    """Return one sentence per trial that was repeated after a stall."""
    return [
        f"{outcome.robot}, {outcome.kind}, seed {outcome.seed} was repeated: its longest cycle took "
        f"{1e3 * first.longest:.1f} ms of processor time, and {1e3 * outcome.longest:.1f} ms in a new process"
        for outcome in outcomes
        if (first := before.get(outcome.key)) is not None
    ]


def worst_trial(outcomes: Sequence[Outcome]) -> Outcome | None:
    """Return the trial with the most severe violation, or None."""
    bad = [outcome for outcome in outcomes if outcome.violations]
    return min(bad, key=lambda outcome: min(map(list(VIOLATIONS).index, outcome.violations)), default=None)


def repeat_command(outcome: Outcome) -> str:
    """Return the command that repeats a trial."""
    robot, walking = shlex.quote(outcome.robot), " --walking" if outcome.walking else ""
    return f"wbc faults {robot} --kinds {outcome.kind} --seed {outcome.seed}{walking} --out repeated"


def write_report(outcomes: Sequence[Outcome], folder: Path, repeated: Sequence[str] = ()) -> str:
    """Write Markdown, CSV and, with plotly, a page with plots; return their names, or raise `ConfigurationError`."""
    rows = rows_of(outcomes)
    try:
        (folder / "faults.md").write_text(_markdown(rows, outcomes, repeated), encoding="utf-8")
        with (folder / "faults.csv").open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, [field.name for field in fields(Row)])
            writer.writeheader()
            for row in map(asdict, rows):
                cells = {key: json.dumps(value) if isinstance(value, dict) else value for key, value in row.items()}
                writer.writerow(cells)
    except OSError as error:
        raise ConfigurationError(f"{folder}: writing of the report failed: {error.strerror or error}") from error
    try:
        require_libraries("plotly")
    except ConfigurationError as error:
        return f"faults.md, faults.csv; no faults.html: {error}"
    bad = sum(bool(outcome.violations) for outcome in outcomes)
    shown = [(_cells(row), not row.violations) for row in rows]
    page = PageReport(
        title="Fault campaign",
        kind="wbc faults",
        verdict=f"{bad} trials with violations." if bad else "No violations.",
        passed=not bad,
        note=f"{summary(outcomes)}.",
        table=ResultTable("Trials", _COLUMNS, shown, words=("ok", "violated")),
        plots=_plots(rows, outcomes),
    )
    write_page(page, folder / "faults.html")
    return "faults.md, faults.csv, faults.html"


def _markdown(rows: Sequence[Row], outcomes: Sequence[Outcome], repeated: Sequence[str]) -> str:
    lines = [f"# Fault campaign\n\n{summary(outcomes)}.\n", *(f"{sentence}.\n" for sentence in repeated)]
    for place, group in groupby(rows, lambda row: row.place):
        lines += [f"\n## {place.capitalize()}\n", f"| {' | '.join(_COLUMNS)} |", "|" + "---|" * len(_COLUMNS)]
        lines += [f"| {' | '.join(_cells(row))} |" for row in group]
    bad = [outcome for outcome in outcomes if outcome.violations]
    if bad:
        lines.append("\n## Violations\n")
        lines += [f"- `{name}`: {text}" for name, text in VIOLATIONS.items() if any(name in o.violations for o in bad)]
        lines.append("")
        for outcome in bad:
            parameters = json.dumps(dict(outcome.parameters), default=str)
            lines.append(f"- `{repeat_command(outcome)}`: {outcome.violations_text} (`{parameters}`)")
    return "\n".join(lines) + "\n"


def _plots(rows: Sequence[Row], outcomes: Sequence[Outcome]) -> list[Plot]:
    shares = by_category(_shares(rows), axis="share of the trials [%]", range=(0.0, 104.0))
    ratios = _by_robot(
        [each for each in outcomes if each.deadline is not None and each.after is not None],
        lambda each: (each.after or 0.0) / (each.deadline or 1.0),
        lambda each: f"{_milliseconds(each.after)} of {_milliseconds(each.deadline)} ms",
    )
    delays = by_category(ratios, axis="time / deadline [1]", limit=1.0)
    detection = (
        "From the beginning of the fault until damping, as a share of the deadline; required: below 1. Only faults "
        "that must be detected."
    )
    survived = [each for each in outcomes if not each.code]
    moved = _by_robot(survived, lambda each: each.moved, lambda each: f"{each.moved:.3f} m")
    distances = by_category(moved, axis="distance [m]")
    motion = (
        "Largest distance of the centre of mass from its position at the beginning of the fault, in survived trials."
    )
    return [
        Plot("shares", "Outcomes of the trials", "Share of the trials by kind of fault, all robots.", shares),
        Plot("delays", "Time until detection", detection, delays),
        Plot("distances", "Motion of the robot", motion, distances),
    ]


def _shares(rows: Sequence[Row]) -> list[Series]:
    counts: dict[str, Counter[str]] = {}  # outcomes by kind of fault
    for row in rows:
        counts.setdefault(row.kind, Counter()).update(row.reasons, survived=row.survived)
    series = []
    for name in dict.fromkeys([*_COLORS, *chain.from_iterable(counts.values())]):
        pairs = [(count[name], count.total()) for count in counts.values()]
        if any(number for number, _ in pairs):
            shares = [100.0 * number / total for number, total in pairs]
            texts = [f"{number} of {total}" for number, total in pairs]
            series.append(Series(name, list(counts), shares, _COLORS.get(name, GREY), "bar", texts))
    bad = list(dict.fromkeys(row.kind for row in rows if row.violations))
    if bad:
        series.append(Series("violations", bad, [102.0] * len(bad), _VIOLATION, "x"))
    return series


def _by_robot(
    outcomes: Sequence[Outcome], value: Callable[[Outcome], float], text: Callable[[Outcome], str]
) -> list[Series]:
    series = []
    for robot, color in zip(dict.fromkeys(each.robot for each in outcomes), cycle(PALETTE), strict=False):
        own = [each for each in outcomes if each.robot == robot]
        texts = [f"seed {each.seed}: {text(each)}" for each in own]
        series.append(Series(robot, [each.kind for each in own], [value(each) for each in own], color, texts=texts))
    return series
