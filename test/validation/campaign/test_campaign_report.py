"""Counts of the report, and its most severe trial."""

import csv
import io
import json
import re

import pytest
from outcomes import outcome
from rich.console import Console
from scipy import stats

from wbc_controller.validation.campaign import campaign_report as report

DETECTED = {"deadline": 0.054, "result": "damped", "code": "STALE_INPUT"}
OUTCOMES = [
    *(outcome(seed=seed) for seed in range(7)),
    *(outcome(seed=seed, result="damped", code="FALLEN", after=0.2) for seed in range(7, 10)),
    *(outcome("message_dropout", seed, after=0.01 * seed, **DETECTED) for seed in (1, 2, 5)),
    outcome("message_dropout", 6, **{**DETECTED, "code": "", "result": "violation"}, violations={"undetected": "not"}),
    outcome("message_dropout", 7, robot="g1", after=0.05, **{**DETECTED, "result": "violation"},
            violations={"over_rate": "at 0.3 s: x", "undetected": "late"}),
]  # fmt: skip


def test_rows_summary_and_table_count_the_trials():
    dropout_g1, dropout, kick = report.rows_of(OUTCOMES)
    assert (dropout_g1.robot, dropout.robot, kick.kind) == ("g1", "go2", "kick")
    assert (kick.trials, kick.survived, kick.reasons, kick.must_be_detected) == (10, 7, {"FALLEN": 3}, 0)
    assert kick.detected_median_s is kick.detected_max_s is kick.deadline_max_s is None
    interval = stats.binomtest(7, 10).proportion_ci(0.95, method="wilson")
    assert (kick.share_low, kick.share_high) == pytest.approx(tuple(interval))
    assert (dropout.must_be_detected, dropout.detected_median_s, dropout.detected_max_s) == (4, 0.02, 0.05)
    assert dropout.deadline_max_s == 0.054
    assert dropout.violations == {"undetected": 1}
    assert report.summary(OUTCOMES).startswith(
        "15 trials, 2 kinds of fault, 2 robots: 8 survived, 7 damped; 3 of 5 faults with a deadline were detected "
        "in time; 2 trials with violations"
    )
    assert report.worst_trial(OUTCOMES) is OUTCOMES[-1]
    assert report.worst_trial(OUTCOMES[:-2]) is None
    assert report.repeat_command(OUTCOMES[-1]) == "wbc faults g1 --kinds message_dropout --seed 7 --out repeated"
    console = Console(width=150, file=io.StringIO())
    console.print(report.terminal_table(OUTCOMES))
    text = console.file.getvalue()
    for part in ("kick", "0.70 (0.40–0.89)", "FALLEN 3", "20 (max 50)", "54", "undetected 1", "over_rate 1"):
        assert part in text


def test_files_agree_also_of_one_trial(tmp_path):
    report.write_report(OUTCOMES, tmp_path)
    page = (tmp_path / "faults.md").read_text(encoding="utf-8")
    assert report.summary(OUTCOMES) in page
    assert "| kick | go2 | 10 | 7 | 0.70 (0.40–0.89) | FALLEN 3 |" in page
    assert "- `wbc faults go2 --kinds message_dropout --seed 6 --out repeated`: undetected: not" in page
    assert page.index("## World and model") > page.index("## Delivery")
    with (tmp_path / "faults.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["kind"], row["robot"], row["survived"]) for row in rows] == [
        ("message_dropout", "g1", "0"), ("message_dropout", "go2", "1"), ("kick", "go2", "7"),
    ]  # fmt: skip
    assert json.loads(rows[2]["reasons"]) == {"FALLEN": 3}
    assert float(rows[1]["detected_max_s"]) == pytest.approx(0.05)
    headings = re.findall("<h2[^>]*>([^<]*)<", (tmp_path / "faults.html").read_text(encoding="utf-8"))
    assert headings == ["Trials", "Outcomes of the trials", "Time until detection", "Motion of the robot"]
    report.write_report([outcome()], tmp_path)
    report.write_report([outcome("message_dropout", after=0.05, **DETECTED)], tmp_path)
    assert "Time until detection" in (tmp_path / "faults.html").read_text(encoding="utf-8")
