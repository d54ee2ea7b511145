"""Trials on real processes: floods of inputs, kills, and 12 s of operation; and the judgement of their results."""

import dataclasses
import types

import numpy as np
import pytest
from domains import own_domain

from wbc_controller.validation.fuzz import soak
from wbc_controller.validation.fuzz.floods import CYCLES, STALL, Stop, StopTrial, _gaps, flood_trials
from wbc_controller.validation.fuzz.kills import METHODS, SLACK, KillTrial, kill_trials

#: Floods here, all with losses that the diagnostics must report; `wbc fuzz floods` has 100 stops in each.
KINDS = ("activate", "update", "large")
#: Least rate of a flood of small and of large messages per second.
LEAST, LEAST_OF_LARGE = 500.0, 1.0
#: Duration and period of the checks of the long run here, s; `wbc fuzz soak` takes half an hour.
SECONDS, PERIOD = 12.0, 0.25
#: Largest growth of the memory within 4.5 s, kB; up to 84 without a leak.
GROWTH = 200


@pytest.mark.live
def test_a_stop_passes_every_flood_within_two_cycles_and_the_loop_goes_on(forks, tmp_path):
    trials = list(flood_trials("go2", tmp_path, 1, kinds=KINDS, domain=own_domain()))
    assert [trial.flood for trial in trials] == list(KINDS)
    for trial in trials:
        print(trial)
        assert trial.rate >= (LEAST_OF_LARGE if trial.flood == "large" else LEAST), trial
        assert trial.obeyed, trial
        assert trial.steady, trial
        assert trial.stop.losses_reported, trial


@pytest.mark.live
def test_no_torques_stay_whatever_is_killed_and_everything_starts_again(forks, tmp_path):
    trials = list(kill_trials("go2", tmp_path, 1, domain=own_domain()))  # `wbc fuzz kills` does 50 of each
    assert [(trial.victim, trial.method) for trial in trials] == [
        (victim, method) for victim in ("controller", "mock") for method in METHODS
    ]
    for trial in trials:
        print(trial)
        assert not trial.failed, trial


@pytest.mark.live
def test_memory_is_flat_and_no_fault_occurs(forks, tmp_path, monkeypatch):
    monkeypatch.setattr(soak, "_CHECK_PERIOD", PERIOD)
    *_, result = soak.soak("go2", tmp_path, SECONDS, own_domain())
    print(result.memory, result.faults, result.rate, result.late)
    assert result.own_faults == []
    for name in ("controller", "mock", "guard"):
        assert result.flat(name), (name, result.memory[name])
        assert result.growth(name) <= GROWTH, (name, result.memory[name])
    assert result.rate > 50.0  # 500 on an idle machine


STOP = Stop(began=0, known=1, ended=2, delay=0.01, late=0.0, sent=5000, seconds=0.5, losses_reported=True)
FLOOD = StopTrial("activate", STOP, CYCLES, STALL, period=0.002)
KILL = KillTrial("controller", "kill", 0.0, 0.014, 0.014, 0.0, 0.05, 0.0, "damping COMMANDS_STOPPED: …", True)


@pytest.mark.parametrize(
    ("change", "late", "obeyed", "steady"),
    [
        ({}, 0.0, True, True),
        ({"cycles": CYCLES + 1}, 0.0, False, True),
        ({"cycles": CYCLES + 2}, 0.002, True, True),
        ({"cycles": CYCLES + 3}, 0.002, False, True),
        ({"slowest": STALL + 0.001}, 0.0, True, False),
        ({"slowest": STALL + 0.003}, 0.002, True, True),
    ],
)
def test_a_flood_is_judged_by_what_the_machine_was_late(change, late, obeyed, steady):
    trial = dataclasses.replace(FLOOD, stop=dataclasses.replace(STOP, late=late), **change)
    assert (trial.obeyed, trial.steady) == (obeyed, steady)


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
def test_a_kill_is_judged_by_what_the_machine_was_late(change, failed):
    assert dataclasses.replace(KILL, **change).failed is failed


def test_cycles_that_lack_in_a_recording_are_found():
    cycles = [types.SimpleNamespace(number=number, stamp=1_000_000_000 + 100 * number)
              for number in (3, 4, 5, 9, 10, 12)]  # fmt: skip
    recorded = types.SimpleNamespace(cycles=lambda: iter(cycles))
    assert _gaps(recorded) == [(1_000_000_500, 1_000_000_900, 3), (1_000_001_000, 1_000_001_200, 1)]


def test_growing_memory_and_own_faults_are_found():
    flat = (100_000 + np.random.default_rng(0).integers(0, 500, 60)).tolist()
    warm_up = [90_000 + 1000 * min(i, 20) for i in range(60)]
    result = soak.SoakResult(60.0, {"flat": flat, "warm-up": warm_up, "leak": [100_000 + 100 * i for i in range(60)]})
    assert [name for name in result.memory if not result.flat(name)] == ["leak"]
    faults = [("damping STALE_INPUT: …", 0.03, 0.05), ("damping FALLEN: …", 0.001, 0.05)]
    assert soak.SoakResult(faults=faults).own_faults == ["damping FALLEN: …"]
