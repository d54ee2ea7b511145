"""Real processes: floods of the controller's inputs do not block an emergency stop."""

import dataclasses
import types

import pytest
from domains import own_domain

from wbc_controller.validation.fuzz.floods import CYCLES, STALL, Stop, StopTrial, _gaps, flood_trials

#: Floods and stops in each; `wbc fuzz floods` has 100 stops.
KINDS, TRIALS = ("activate", "update", "large"), 1
#: Least rate of a flood, messages per second.
LEAST = {"large": 1.0}
LEAST_OF_SMALL = 500.0
#: Inputs with losses that the diagnostics must report.
NAMED = {"activate", "update", "large"}


@pytest.mark.live
def test_a_stop_passes_every_flood_within_two_cycles_and_the_loop_goes_on(forks, tmp_path):
    trials = list(flood_trials("go2", tmp_path, TRIALS, kinds=KINDS, domain=own_domain()))
    assert [trial.flood for trial in trials] == [kind for kind in KINDS for _ in range(TRIALS)]
    for trial in trials:
        print(trial)
        assert trial.rate >= LEAST.get(trial.flood, LEAST_OF_SMALL), trial
        assert trial.obeyed, trial
        assert trial.steady, trial
        assert trial.stop.losses_reported or trial.flood not in NAMED, trial


STOP = Stop(began=0, known=1, ended=2, delay=0.01, late=0.0, sent=5000, seconds=0.5, losses_reported=True)
TRIAL = StopTrial("activate", STOP, CYCLES, STALL, period=0.002)


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
def test_a_trial_is_judged_by_what_the_machine_was_late(change, late, obeyed, steady):
    trial = dataclasses.replace(TRIAL, stop=dataclasses.replace(STOP, late=late), **change)
    assert (trial.obeyed, trial.steady) == (obeyed, steady)


def test_cycles_that_lack_in_a_recording_are_found():
    cycles = [types.SimpleNamespace(number=number, stamp=1_000_000_000 + 100 * number)
              for number in (3, 4, 5, 9, 10, 12)]  # fmt: skip
    recorded = types.SimpleNamespace(cycles=lambda: iter(cycles))
    assert _gaps(recorded) == [(1_000_000_500, 1_000_000_900, 3), (1_000_001_000, 1_000_001_200, 1)]
