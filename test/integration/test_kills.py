"""Real processes: controller and mock robot are killed, hung up and stopped at random times."""

import dataclasses

import pytest
from domains import own_domain

from wbc_controller.validation.fuzz.kills import METHODS, SLACK, KillTrial, kill_trials


@pytest.mark.live
def test_no_torques_stay_whatever_is_killed_and_everything_starts_again(forks, tmp_path):
    trials = list(kill_trials("go2", tmp_path, 1, domain=own_domain()))  # `wbc fuzz kills` does 50 of each
    assert [(trial.victim, trial.method) for trial in trials] == [
        (victim, method) for victim in ("controller", "mock") for method in METHODS
    ]
    for trial in trials:
        print(trial)
        assert not trial.failed, trial


TRIAL = KillTrial("controller", "kill", 0.0, 0.014, 0.014, 0.0, 0.05, 0.0, "damping COMMANDS_STOPPED: …", True)


@pytest.mark.parametrize(
    ("change", "failed"),
    [
        ({}, False),
        ({"gap": 0.014 + SLACK + 0.001}, True),
        ({"gap": 0.014 + SLACK + 0.001, "late": 0.001}, False),
        ({"stale": 0.05 + SLACK + 0.001}, True),
        ({"state_correct": False}, True),
    ],
)
def test_a_trial_is_judged_by_what_the_machine_was_late(change, failed):
    assert dataclasses.replace(TRIAL, **change).failed is failed
