"""Fuzzer of setpoints: joints keep their limits with any setpoint; an excess is detected."""

import re

import pytest
from command_line import wbc

from wbc_controller.simulation.simulation import Simulation
from wbc_controller.validation.fuzz import setpoints
from wbc_controller.validation.fuzz.setpoints import KINDS, fuzz_setpoints, run_trial, summary


@pytest.fixture(scope="module")
def go2():
    return Simulation("go2")


def test_joints_keep_their_limits(monkeypatch):
    monkeypatch.setattr(setpoints, "DURATION", 1.0)
    result = wbc("fuzz", "setpoints", "go2,g1", "--minutes", "0.01")
    line = re.compile(r"(go2|g1) +\d+ trials, \d+ s under control, \d+ ended in damping; .*above 0.02 in 0 trials; .*")
    assert [line.fullmatch(said)[1] for said in result.stdout.splitlines()] == ["go2", "g1"]


def test_seed_and_number_determine_the_trial(go2, monkeypatch):
    monkeypatch.setattr(setpoints, "DURATION", 0.5)
    first, again, other = (run_trial(go2, "go2", 3, number) for number in (5, 5, 5 + len(KINDS)))
    assert first.kind == "mix" == other.kind
    assert again == first != other
    assert -0.8 < first.excess < 0.02


def test_trials_continue_for_the_given_time_and_a_violated_limit_is_a_status(monkeypatch):
    monkeypatch.setattr(setpoints, "DURATION", 0.2)
    trials = list(fuzz_setpoints(["go2"], 0.008, 0, 2))
    assert [trial.number for trial in trials] == list(range(2, 2 + len(trials)))
    assert len(trials) == 3
    assert sum(trial.seconds for trial in trials) >= 0.48 > sum(trial.seconds for trial in trials[:-1])
    worst = max(trials, key=lambda trial: trial.excess)
    (line,) = summary(trials)
    assert f"({worst.joint}, trial {worst.number}, {worst.kind})" in line
    monkeypatch.setattr(setpoints, "MAX_EXCESS", -10.0)
    result = wbc("fuzz", "setpoints", "go2", "--minutes", "0.001", status=1)
    assert re.search(r"above -10 in [1-9]\d* trials", result.output)


class Bent(Simulation):
    """One knee without a stop moves beyond its limit."""

    def reset(self):
        super().reset()
        step, knee = self.plant.step, self.plant.model.joint("RL_calf_joint")
        self.plant.model.jnt_limited[knee.id] = 0

        def bent():
            step()
            self.plant.data.qpos[knee.qposadr[0]] += 0.0008

        self.plant.step = bent


class Struck(Simulation):
    """After an impact of a calf, its knee is beyond the stop for 10 ms."""

    excess = 0.03

    def reset(self):
        super().reset()
        model, state, struck = self.controller.model, self.plant.state, self.time + 0.1
        knee = model.joints.index("RL_calf_joint")

        def flung():
            q, v = state()
            if struck <= self.time < struck + 0.01:
                q[model.q_places][knee] = model.position_upper[knee] + self.excess
            return q, v

        self.plant.state = flung
        self.plant.links_on_the_floor = lambda: frozenset(["RL_calf"] if self.time >= struck else [])


def test_impacts_are_reported_separately(monkeypatch):
    monkeypatch.setattr(setpoints, "DURATION", 0.2)
    trial = run_trial(Struck("go2"), "go2", 0, 0)
    assert trial.impact == pytest.approx(Struck.excess)
    assert not trial.failed


class Kneeling(Bent):
    """The same with permanent contact of a knee with the floor."""

    def reset(self):
        super().reset()
        self.plant.links_on_the_floor = lambda: frozenset(["RL_calf"])


@pytest.mark.parametrize("robot", [Bent, Kneeling])
def test_excess_counts_with_a_link_on_the_floor(robot):
    trial = run_trial(robot("go2"), "go2", 0, 0)
    assert (trial.joint, trial.failed) == ("RL_calf_joint", True), trial
