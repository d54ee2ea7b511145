"""Trials of the controller, and of a controller with an injected defect."""

import dataclasses
import itertools
import time

import numpy as np
import pytest
from refusals import refusal
from unchecked import UNCHECKED

from wbc_controller.safety.supervisor import Supervisor
from wbc_controller.validation.campaign.request_faults import REQUEST_KINDS
from wbc_controller.validation.campaign.trial import ALL_KINDS, _Trial, run_trial

SHORT = {"start": 0.02, "duration": 0.06}


@pytest.mark.parametrize(
    ("kind", "parameters", "result", "code"),
    [
        ("message_duplication", {"gap": 0.002}, "survived", ""),
        ("message_dropout", {"stream": "joint_states"}, "damped", "STALE_INPUT"),
        ("odom_jump", {"size": 1.0}, "damped", "IMPLAUSIBLE_STATE"),
        ("clock_jump", {"by": -1.0}, "damped", "CLOCK"),
        ("garbage", {}, "survived", ""),
    ],
)
def test_controller_survives_harmless_faults_and_is_damped_in_time(kind, parameters, result, code):
    outcome = run_trial("go2", kind, 0, parameters={**SHORT, **parameters})
    assert (outcome.result, outcome.code, dict(outcome.violations)) == (result, code, {})
    if code:
        assert 0.0 <= outcome.after <= outcome.deadline
    else:
        assert outcome.after is None


def test_seed_changes_the_trial(monkeypatch):
    """`test_run.py` repeats a trial with the same seed."""
    monkeypatch.setattr(_Trial, "run", lambda trial: None)
    first, other = (run_trial("go2", "joint_absurd", seed) for seed in (2, 3))
    assert other.parameters["value"] != first.parameters["value"]


def test_unknown_kind_is_refused_and_request_faults_are_complete():
    assert "did you mean 'odom_jump'" in refusal(run_trial, "go2", "odom_jumb", 0)
    assert set(REQUEST_KINDS) < set(ALL_KINDS)
    assert {kind.place for kind in REQUEST_KINDS.values()} == {"user"}


@pytest.fixture(autouse=True)
def _short_end(monkeypatch):
    monkeypatch.setattr("wbc_controller.validation.campaign.trial._AFTER_FAULT", 0.25)
    monkeypatch.setattr("wbc_controller.validation.campaign.trial._AFTER_DAMPING", 0.05)


def _without_rate(controller):
    limits = dataclasses.replace(controller.supervisor.limits, torque_rate=1e6)
    controller.supervisor = Supervisor(controller.model, limits)


def _with_a_command_of_nan(controller):
    """Send a command with NaN before the fault."""
    step, numbers = controller.supervisor.step, itertools.count(1)

    def changed(*arguments):
        command = step(*arguments)
        return command._replace(tau=command.tau * np.nan) if command and next(numbers) == 15 else command

    controller.supervisor.step = changed


def _without_detection(controller):
    """Disable the detection of implausible states and falls."""
    limits = controller.supervisor.limits
    unchecked = limits.safety.model_copy(update=UNCHECKED)
    controller.supervisor = Supervisor(controller.model, dataclasses.replace(limits, safety=unchecked))


def _old_states(controller):
    """Use states of any age."""
    cycle = controller.cycle
    velocity = np.zeros(controller.model.nj)

    def careless(inputs):
        measured = velocity if inputs.joint_velocity is None else inputs.joint_velocity
        return cycle(dataclasses.replace(inputs, problem=None, joint_velocity=measured))

    controller.cycle = careless
    # The loop also uses the largest age.
    settings = controller._live.settings
    safety = settings.safety.model_copy(update={"state_timeout": 10.0})
    controller._live = dataclasses.replace(controller._live, settings=settings.model_copy(update={"safety": safety}))


def _fails(controller):
    sample, numbers = controller.board.sample, itertools.count(1)
    controller.board.sample = lambda time: 1 / 0 if next(numbers) == 15 else sample(time)


@pytest.mark.parametrize(
    ("kind", "parameters", "prepare", "violation"),
    [
        ("estop", {}, _with_a_command_of_nan, "not_finite"),
        ("estop", {}, _fails, "internal_error"),
        ("estop", {}, lambda controller: controller.supervisor.request("estop", 0.0, None), "start"),
        ("message_dropout", {"duration": 0.15}, _old_states, "stale"),
        ("joint_states_frozen", {"duration": 0.2}, _without_detection, "undetected"),
        ("kick", {"speed": 2.0, "duration": 0.6, "seed": 2}, _without_detection, "fell"),
    ],
)
def test_broken_controllers_are_detected(kind, parameters, prepare, violation):
    outcome = run_trial("go2", kind, 0, parameters={**SHORT, **parameters}, prepare=prepare)
    assert outcome.result == "violation"
    assert violation in outcome.violations, outcome.violations


def test_unclipped_torque_rate_is_detected():
    """The torques of a heavy robot rise at its activation."""
    assert "over_rate" in run_trial("talos", "estop", 0, parameters=SHORT, prepare=_without_rate).violations


def _in_cycle(number, change):
    """Apply a function to the inputs of one cycle."""

    def prepare(controller):
        cycle, numbers = controller.cycle, itertools.count(1)
        controller.cycle = lambda inputs: cycle(change(inputs) if next(numbers) == number else inputs)

    return prepare


def test_slow_loop_is_a_stall():
    def slow(inputs):
        began = time.thread_time()
        while time.thread_time() - began < 0.025:
            pass
        return inputs

    assert "stall" in run_trial("go2", "estop", 0, parameters=SHORT, prepare=_in_cycle(40, slow)).violations


def test_wrong_fault_code_is_a_violation():
    """An external stop during the trial of a harmless fault."""
    stops = _in_cycle(40, lambda inputs: dataclasses.replace(inputs, requests=("estop",)))
    for start, violation in ((0.02, "wrong_reason"), (0.4, "early")):
        outcome = run_trial("go2", "imu_noise", 0, parameters={**SHORT, "start": start}, prepare=stops)
        assert violation in outcome.violations
