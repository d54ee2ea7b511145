"""Outcomes of service commands, from the cycle that processed them."""

from types import SimpleNamespace

import pytest

from wbc_controller.controller.report import LatchedInputs, UserRequests
from wbc_controller.nodes.ros2 import command_outcomes
from wbc_controller.nodes.ros2.command_outcomes import CommandOutcomes
from wbc_controller.records import Fault, Mode


@pytest.fixture
def asked():
    """A pending 'activate', and the list of its responses."""
    return send("activate")


def send(word):
    waiting, outcome = CommandOutcomes(), []
    waiting.submit(word, lambda: None, lambda *respond: outcome.append(respond))
    return waiting, outcome


def report(mode=Mode.INACTIVE, requests=(), refused=(), fault=None):
    inputs = LatchedInputs(state=None, joint_velocity=None, ages={}, requests=UserRequests(commands=requests))
    return SimpleNamespace(mode=mode, inputs=inputs, refused=refused, fault=fault)


def test_cycles_that_have_not_taken_it_do_not_answer(asked):
    waiting, outcome = asked
    for _ in range(20):
        waiting.observe(report())
        waiting.observe(report(requests=("reset",), refused=("command 'reset' is refused",)))
    assert outcome == []
    waiting.observe(report(Mode.ACTIVE, ("activate",)))
    waiting.observe(report(Mode.ACTIVE, ("activate",)))
    assert outcome == [(True, "active")]


def test_a_refusal_is_the_answer(asked):
    waiting, outcome = asked
    waiting.observe(report(Mode.ACTIVE, ("activate",), ("command 'activate' is refused: why",)))
    assert outcome == [(False, "command 'activate' is refused: why")]


def test_an_unconfirmed_command_has_the_reason(asked):
    waiting, outcome = asked
    waiting.observe(report(Mode.DAMPING, ("activate",), fault=Fault("FALLEN", "it lies")))
    assert outcome == [(False, "damping FALLEN: it lies")]


@pytest.mark.parametrize(
    ("last", "respond"),
    [
        (report(Mode.INACTIVE), (True, "inactive")),
        (
            report(Mode.DAMPING, fault=Fault("STALE_INPUT", "odom is late")),
            (False, "damping STALE_INPUT: odom is late"),
        ),
    ],
)
def test_a_deactivation_is_answered_at_the_end_of_its_ramp(last, respond):
    waiting, outcome = send("deactivate")
    waiting.observe(report(Mode.ACTIVE, ("deactivate",)))
    for mode in (Mode.ACTIVE, Mode.HOLDING, Mode.ACTIVE):
        waiting.observe(report(mode, refused=("command 'deactivate' is refused",)))  # another fault
    assert outcome == []
    waiting.observe(last)
    assert outcome == [respond]


def test_one_that_was_turned_away_is_answered_too(asked, monkeypatch):
    monkeypatch.setattr(command_outcomes, "_LONGEST_WAIT", 10)
    waiting, outcome = asked
    for _ in range(9):
        waiting.observe(report())
    assert outcome == []
    waiting.observe(report())
    assert outcome == [(False, "command 'activate' was dropped: not processed in 10 cycles; send it again")]


def test_the_end_of_the_loop_answers(asked):
    waiting, outcome = asked
    waiting.end("over")
    assert outcome == [(False, "over")]
