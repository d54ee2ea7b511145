"""Recordings of a campaign's faults: each names its fault and is replayed."""

import re

import pytest

from wbc_controller.validation.campaign.recordings import Place
from wbc_controller.validation.campaign.trial import run_trial


@pytest.mark.parametrize("kind", ["joint_absurd", "odom_jump", "stamp_zero", "estop_in_flood"])
def test_a_fault_is_named_by_its_recording_which_comes_out_again(kind, tmp_path):
    outcome = run_trial("go2", kind, 0, recordings=tmp_path)
    assert (outcome.result, dict(outcome.violations)) == ("damped", {})
    run_trial("go2", kind, 0, recordings=tmp_path)  # replaces the first recording
    (path,) = tmp_path.iterdir()
    assert re.fullmatch(rf"go2-{kind}-0-\d+-\d+-{outcome.code}\.mcap", path.name)


@pytest.fixture(scope="module")
def left(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recordings")
    outcome = run_trial("go2", "joint_absurd", 0, parameters={"start": 0.02}, recordings=folder)
    assert not outcome.violations
    return Place(folder, "go2-joint_absurd-0"), outcome


def test_what_another_fault_left_is_found_out(left):
    place, outcome = left
    assert place.mistake(outcome.code, outcome.sentence) == ""
    assert place.mistake("FALLEN", outcome.sentence).endswith("does not name FALLEN")
    assert "does not name" in place.mistake(outcome.code, "another reason")
    assert Place(place.folder, "g1-joint_absurd-0").mistake("FALLEN", "") == "no recording of FALLEN"


def test_cycles_that_come_out_differently_are_found_out(left, monkeypatch):
    place, outcome = left
    monkeypatch.setattr("wbc_controller.recording.replay.cycle_replay.ReplayedCycle.same", False)
    assert re.search(r"replay of (\d+) of \1 cycles differs", place.mistake(outcome.code, outcome.sentence))


def test_a_damaged_recording_is_found_out(left):
    place, outcome = left
    (path,) = place.folder.iterdir()
    path.write_bytes(path.read_bytes()[:40])
    assert str(path) in place.mistake(outcome.code, outcome.sentence)


def test_a_trial_says_what_its_recording_lacks(tmp_path, monkeypatch):
    monkeypatch.setattr(Place, "mistake", lambda place, code, sentence: f"no {code}")
    outcome = run_trial("go2", "joint_absurd", 0, parameters={"start": 0.02}, recordings=tmp_path)
    assert outcome.result == "violation"
    assert outcome.violations["recording"].endswith(f"no {outcome.code}")
