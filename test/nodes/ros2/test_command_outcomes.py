"""Outcomes of service commands, from the cycle that processed them."""

from types import SimpleNamespace

import pytest

from wbc_controller.controller.report import LatchedInputs, UserRequests
from wbc_controller.nodes.ros2 import command_outcomes
from wbc_controller.nodes.ros2.command_outcomes import CommandOutcomes
from wbc_controller.records import Fault, Mode


def send(word):
    waiting, outcome = CommandOutcomes(), []
    waiting.submit(word, lambda: None, lambda *respond: outcome.append(respond))
    return waiting, outcome


def report(mode=Mode.INACTIVE, requests=(), refused=(), fault=None):
    inputs = LatchedInputs(state=None, joint_velocity=None, ages={}, requests=UserRequests(commands=requests))
    return SimpleNamespace(mode=mode, inputs=inputs, refused=refused, fault=fault)


def test_cycles_that_have_not_taken_it_do_not_answer():
    waiting, outcome = send("activate")
    for _ in range(20):
        waiting.observe(report())
        waiting.observe(report(requests=("reset",), refused=("command 'reset' is refused",)))
    assert outcome == []
    waiting.observe(report(Mode.ACTIVE, ("activate",)))
    waiting.observe(report(Mode.ACTIVE, ("activate",)))
    assert outcome == [(True, "active")]


REFUSED = "command 'activate' is refused: why"


@pytest.mark.parametrize(
    ("last", "answer"),
    [
        (report(Mode.ACTIVE, ("activate",), (REFUSED,)), (False, REFUSED)),
        (report(Mode.DAMPING, ("activate",), fault=Fault("FALLEN", "it lies")), (False, "damping FALLEN: it lies")),
        (None, (False, "over")),
    ],
)
def test_a_refusal_a_fault_and_the_end_of_the_loop_are_answers(last, answer):
    waiting, outcome = send("activate")
    waiting.end("over") if last is None else waiting.observe(last)
    assert outcome == [answer]


@pytest.mark.parametrize(
    ("mode", "fault", "answer"),
    [
        (Mode.INACTIVE, None, (True, "inactive")),
        (Mode.DAMPING, Fault("STALE_INPUT", "odom is late"), (False, "damping STALE_INPUT: odom is late")),
    ],
)
def test_a_deactivation_is_answered_at_the_end_of_its_ramp(mode, fault, answer):
    waiting, outcome = send("deactivate")
    waiting.observe(report(Mode.ACTIVE, ("deactivate",)))
    for other in (Mode.ACTIVE, Mode.HOLDING, Mode.ACTIVE):
        waiting.observe(report(other, refused=("command 'deactivate' is refused",)))  # another fault
    assert outcome == []
    waiting.observe(report(mode, fault=fault))
    assert outcome == [answer]


def test_one_that_was_turned_away_is_answered_too(monkeypatch):
    monkeypatch.setattr(command_outcomes, "_LONGEST_WAIT", 10)
    waiting, outcome = send("activate")
    for _ in range(9):
        waiting.observe(report())
    assert outcome == []
    waiting.observe(report())
    assert outcome == [(False, "command 'activate' was dropped: not processed in 10 cycles; send it again")]
