"""File of a campaign: all outcomes, no foreign ones, and a valid file after an interruption."""

import json

import pytest
from outcomes import outcome

from wbc_controller.errors import ConfigurationError
from wbc_controller.validation.campaign import results as results_module
from wbc_controller.validation.campaign.results import FILE, Results, TrialKey, version_of


def write(folder, *outcomes) -> None:
    results = Results(folder)
    for each in outcomes:
        results.add(each)
    results.close()


def test_outcomes_are_read_again(tmp_path):
    both = outcome(), outcome(seed=1, result="damped", code="FALLEN", after=0.25, sentence="it fell: 60°")
    write(tmp_path, *both)
    again = Results(tmp_path)
    again.close()
    assert again.outcomes == {each.key: each for each in both}
    assert again.other_versions == 0


def test_results_of_other_versions_are_unused(tmp_path, monkeypatch):
    write(tmp_path, outcome())
    monkeypatch.setattr(results_module, "version_of", lambda robot: "another")
    again = Results(tmp_path)
    assert (again.outcomes, again.other_versions) == ({}, 1)
    again.add(outcome())
    assert len((tmp_path / FILE).read_text(encoding="utf-8").splitlines()) == 2  # written at once
    again.close()


def test_lines_of_other_versions_may_have_other_fields(tmp_path):
    (tmp_path / FILE).write_text('{"version": "old", "robot": "go2", "wall": 1.0}\n', encoding="utf-8")
    results = Results(tmp_path)
    results.close()
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
    write(tmp_path, outcome(), outcome(seed=1))
    path = tmp_path / FILE
    path.write_text(path.read_text(encoding="utf-8")[:-30], encoding="utf-8")
    results = Results(tmp_path)
    assert set(results.outcomes) == {TrialKey("go2", "kick", 0)}
    results.add(outcome(seed=2))
    results.close()
    again = Results(tmp_path)
    again.close()
    assert set(again.outcomes) == {TrialKey("go2", "kick", 0), TrialKey("go2", "kick", 2)}


def test_invalid_file_is_refused_with_its_line(tmp_path):
    write(tmp_path, outcome())
    path = tmp_path / FILE
    valid = path.read_text(encoding="utf-8")
    for line in ("no json", "5", json.dumps({"version": "x"}), json.dumps({"robot": "go2"})):
        path.write_text(valid + line + "\n", encoding="utf-8")
        with pytest.raises(ConfigurationError, match=rf"{FILE}:2: invalid line of a fault campaign"):
            Results(tmp_path)
    with pytest.raises(ConfigurationError, match="opening of the results failed"):
        Results(path)
