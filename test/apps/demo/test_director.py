"""Timeouts of the director."""

from unittest.mock import Mock

import numpy as np
import pytest

from wbc_controller.apps.demo import director
from wbc_controller.apps.demo.director import DemoFailed, Director
from wbc_controller.apps.demo.scenario import SCENARIOS
from wbc_controller.middleware.codec import encode
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.nodes.wiring import topics_of


class Activated(Exception):
    """The controller is active, and time passes."""


@pytest.fixture
def play(make, robot_of):
    """Return a function that plays a scenario with a standing mock robot and scripted modes of the controller."""
    settings, model = robot_of("go2")
    topics, bus = topics_of(settings), MemoryBus()
    say_joints = MemoryTransport(bus).advertise(topics["mock", "joint_states", ""])
    say_mode = MemoryTransport(bus).advertise(topics["controller", "state", ""])

    def play(modes):
        count = 0

        def advance(arrived):
            nonlocal count
            count += 1
            if "active" in modes.values() and count > max(modes):
                raise Activated
            say_joints(encode(make.joint_state(model.joints, np.zeros(model.nj), time=2_000_000 * count)))
            if count in modes:
                say_mode(encode(make.string(modes[count])))

        Director(settings, model, SCENARIOS["go2"], MemoryTransport(bus), advance, Mock(), Mock()).play()

    return play


def test_late_controller_and_late_activation(play):
    with pytest.raises(Activated):
        play({3000: "inactive", 9000: "active"})


@pytest.mark.parametrize(
    ("modes", "sentence"),
    [
        ({}, r"timeout: no state of the controller within 0\.2 s"),
        ({5: "inactive"}, "did not become active; its state is 'inactive'"),
    ],
)
def test_timeout(play, monkeypatch, modes, sentence):
    monkeypatch.setattr(director, "_TIMEOUT", 0.2)
    with pytest.raises(DemoFailed, match=sentence):
        play(modes)
