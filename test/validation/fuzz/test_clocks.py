"""Fuzzer of clocks and load: robots stand or are damped by a fault; injected defects are detected."""

import numpy as np
from command_line import wbc

from wbc_controller.nodes.inputs import Inputs
from wbc_controller.validation.campaign.monitor import MonitoredRobot
from wbc_controller.validation.fuzz import clocks
from wbc_controller.validation.fuzz.clocks import CLOCKS, ClockTrial, run_trial


def test_no_fall_without_a_fault():
    lines = wbc("fuzz", "clocks", "go2", "--count", "9", "--first", "9").stdout.splitlines()
    assert [line.split()[:2] for line in lines] == [["go2", clock] for clock in CLOCKS]
    for outcome in ("survived", "refused", "STALE_INPUT", "CLOCK"):
        assert any(outcome in line for line in lines), outcome


def test_seed_and_number_determine_the_trial():
    trial = run_trial("go2", 3, 4)
    assert run_trial("go2", 3, 4) == trial != run_trial("go2", 4, 4)


def test_torques_from_stale_states_are_detected(monkeypatch):
    monkeypatch.setattr(Inputs, "fault", lambda self, ages, timeout: None)
    monkeypatch.setattr("wbc_controller.nodes.loop.stale_inputs", lambda ages, timeout: None)
    assert run_trial("go2", 0, 9).why.startswith("stale: at ")


def test_exit_status_after_a_fall_without_a_fault(monkeypatch):
    monkeypatch.setattr(MonitoredRobot, "has_fallen", lambda self: True)
    result = wbc("fuzz", "clocks", "go2", "--count", "1", "--first", "15", status=1)
    assert "go2, trial 15" in result.output
    assert "; the robot fell without a fault" in result.output


def test_clock_moves_in_steps():
    stamps = []

    class ObservedTrial(clocks._Standing):
        def _period(self):
            super()._period()
            stamps.append(self.clock.stamp())

    steps = clocks.ClockSteps(step=0.02, start=0.0, duration=60.0)
    trial = ClockTrial("go2", 0, "simulated", "clock_steps", late=False)
    ObservedTrial(trial, [steps], True, np.random.default_rng(0)).run()
    assert {stamp % 20_000_000 for stamp in stamps} == {0}
    assert len(set(stamps)) > 20
