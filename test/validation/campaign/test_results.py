"""File of a campaign: all outcomes, no foreign ones, and a valid file after an interruption."""

import contextlib
import json

from outcomes import outcome
from refusals import refusal

from wbc_controller.validation.campaign import results as results_module
from wbc_controller.validation.campaign.results import FILE, Results, TrialKey, version_of


def stored(folder, *outcomes) -> Results:
    """Return the results of a folder, to which some outcomes are added."""
    with contextlib.closing(Results(folder)) as results:
        for each in outcomes:
            results.add(each)
    return results


def test_outcomes_are_read_again(tmp_path):
    both = outcome(), outcome(seed=1, result="damped", code="FALLEN", after=0.25, sentence="it fell: 60°")
    stored(tmp_path, *both)
    again = stored(tmp_path)
    assert again.outcomes == {each.key: each for each in both}
    assert again.other_versions == 0


def test_results_of_other_versions_are_unused(tmp_path, monkeypatch):
    stored(tmp_path, outcome())
    monkeypatch.setattr(results_module, "version_of", lambda robot: "another")
    again = Results(tmp_path)
    assert (again.outcomes, again.other_versions) == ({}, 1)
    again.add(outcome())
    assert len((tmp_path / FILE).read_text(encoding="utf-8").splitlines()) == 2  # written at once
    again.close()


def test_lines_of_other_versions_may_have_other_fields(tmp_path):
    (tmp_path / FILE).write_text('{"version": "old", "robot": "go2", "wall": 1.0}\n', encoding="utf-8")
    results = stored(tmp_path)
    assert (results.outcomes, results.other_versions) == ({}, 1)


def test_version_depends_on_code_and_configuration(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("a: 1\n", encoding="utf-8")
    before = version_of(str(path))
    assert before == version_of(str(path))
    path.write_text("a: 2\n", encoding="utf-8")
    assert before != version_of(str(path))
    assert version_of("go2") != version_of("g1")


def test_incomplete_line_is_dropped(tmp_path):
    stored(tmp_path, outcome(), outcome(seed=1))
    path = tmp_path / FILE
    path.write_text(path.read_text(encoding="utf-8")[:-30], encoding="utf-8")
    for results in (stored(tmp_path, outcome(seed=2)), stored(tmp_path)):
        assert set(results.outcomes) == {TrialKey("go2", "kick", 0), TrialKey("go2", "kick", 2)}


def test_invalid_file_is_refused_with_its_line(tmp_path):
    stored(tmp_path, outcome())
    path = tmp_path / FILE
    valid = path.read_text(encoding="utf-8")
    for line in ("no json", "5", json.dumps({"version": "x"}), json.dumps({"robot": "go2"})):
        path.write_text(valid + line + "\n", encoding="utf-8")
        assert f"{FILE}:2: invalid line of a fault campaign" in refusal(Results, tmp_path)
    assert "opening of the results failed" in refusal(Results, path)
