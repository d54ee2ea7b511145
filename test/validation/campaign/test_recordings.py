"""Recordings of a campaign's faults: each names its fault and is replayed."""

import re

import pytest
from refusals import refusal

from wbc_controller.validation.campaign.trial import ALL_KINDS, TrialRecordings, run_trial


@pytest.mark.parametrize("kind", ["stamp_zero", "estop_in_flood"])
def test_recordings_name_their_fault_and_are_replayed(kind, tmp_path):
    (tmp_path / f"go2-{kind}-0-20261126-120000-ESTOP.mcap").touch()  # of an earlier run: replaced
    outcome = run_trial("go2", kind, 0, parameters={"start": 0.02}, recordings=tmp_path)
    assert (outcome.result, dict(outcome.violations)) == ("damped", {})
    (path,) = tmp_path.iterdir()
    assert re.fullmatch(rf"go2-{kind}-0-\d+-\d+-{outcome.code}\.mcap", path.name)


#: A kind of fault by place.
WALKING = {"joint sensors": "joint_absurd", "stamps and clock": "clock_frozen", "user": "estop"}
#: Places in `test/recording/replay/test_walking_replay.py`.
REPLAYED = {"odometry and IMU", "delivery", "delivery of commands", "actuators", "world and model"}


def test_each_place_of_faults_is_tested_during_a_step():
    assert {kind.place for kind in ALL_KINDS.values()} == WALKING.keys() | REPLAYED
    assert all(ALL_KINDS[kind].place == place for place, kind in WALKING.items())


@pytest.mark.parametrize("kind", WALKING.values())
def test_a_fault_during_a_step_leaves_a_recording_that_names_it(kind, tmp_path, monkeypatch):
    monkeypatch.setattr("wbc_controller.validation.campaign.trial._STEPS", 0)
    outcome = run_trial("g1", kind, 0, True, parameters={"start": 0.1}, recordings=tmp_path)
    assert (outcome.result, dict(outcome.violations), outcome.walking) == ("damped", {}, True)
    assert outcome.moved > 0.02
    (path,) = tmp_path.iterdir()
    assert outcome.code in path.name


def test_a_robot_that_cannot_walk_is_refused():
    assert "a1.yaml cannot walk" in refusal(run_trial, "examples/a1.yaml", "estop", 0, True)


def test_recordings_without_the_fault_and_different_replays_are_detected(tmp_path, monkeypatch):
    outcome = run_trial("go2", "joint_absurd", 0, parameters={"start": 0.02}, recordings=tmp_path)
    assert not outcome.violations
    place, code, sentence = TrialRecordings(tmp_path, "go2-joint_absurd-0"), outcome.code, outcome.sentence
    assert place.error_of_fault("FALLEN", sentence).endswith("does not name FALLEN")
    assert "does not name" in place.error_of_fault(code, "another reason")
    assert TrialRecordings(tmp_path, "g1-joint_absurd-0").error_of_fault("FALLEN", "") == "no recording of FALLEN"
    with monkeypatch.context() as patch:
        patch.setattr("wbc_controller.recording.replay.cycle_replay.ReplayedCycle.is_identical", False)
        assert re.search(r"replay of (\d+) of \1 cycles differs", place.error_of_fault(code, sentence))
    (path,) = tmp_path.iterdir()
    path.write_bytes(path.read_bytes()[:40])
    assert str(path) in place.error_of_fault(code, sentence)


def test_errors_of_recordings_are_violations(tmp_path, monkeypatch):
    monkeypatch.setattr(TrialRecordings, "error_of_fault", lambda place, code, sentence: f"no {code}")
    outcome = run_trial("go2", "estop", 0, parameters={"start": 0.02, "duration": 0.06}, recordings=tmp_path)
    assert outcome.result == "violation"
    assert outcome.violations["recording"].endswith(f"no {outcome.code}")
