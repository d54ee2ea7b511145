"""Faults of the mock robot by topic and by script."""

import threading

import numpy as np
import pytest
from peer import MockPeer
from stepping import has_faults, step

from wbc_controller.errors import ConfigurationError, InputRefused
from wbc_controller.middleware.transports.memory import MemoryBus
from wbc_controller.simulation.faults.catalogue import read_faults
from wbc_controller.simulation.mock_robot import MockRobot
from wbc_controller.simulation.mock_service import run_mock


@pytest.fixture
def stand(go2):
    model, settings = go2
    peer = MockPeer(MemoryBus(), settings)
    return MockRobot(model, settings, peer.transport), peer


def test_a_fault_by_topic_acts_for_its_duration_or_until_clear(stand):
    robot, peer = stand
    step(robot, 3)
    peer.say("fault", "{kind: odom_jump, size: 1.0, start: 0.004, duration: 0.006}")
    step(robot, 9)
    off = [abs(content.pose.pose.position.x) + abs(content.pose.pose.position.y) > 0.5 for content in peer.all("odom")]
    # It arrives in the period that begins at 0.006 s, so that it acts from 0.010 s on: sample 5.
    assert np.flatnonzero(off).tolist() == [5, 6, 7]
    peer.say("fault", "[{kind: joint_missing, duration: 10.0}, {kind: message_dropout, stream: odom, duration: 10.0}]")
    step(robot, 3)
    assert has_faults(robot.faults)
    assert (len(peer.all("odom")), len(peer.all("joint_states")[-1].name)) == (13, 11)
    peer.say("fault", "clear")
    step(robot, 2)
    assert not has_faults(robot.faults)
    assert (len(peer.all("odom")), len(peer.all("joint_states")[-1].name)) == (14, 12)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{kind: odom_jumb}", "did you mean 'odom_jump'?"),
        ("[{kind: kick}, {kind: joint_locked, joint: knee}]", "unknown joint 'knee'"),
    ],
)
def test_a_fault_that_cannot_be_used_is_refused_with_a_sentence(stand, caplog, text, said):
    robot, peer = stand
    peer.say("fault", text)
    step(robot)
    (sentence,) = caplog.messages
    assert sentence.startswith("fault refused: ")
    assert said in sentence
    assert not has_faults(robot.faults)


def test_commands_are_lost_and_torques_are_changed_on_their_way(stand):
    robot, peer = stand

    def applied(number):
        robot.publish()
        peer.effort(np.full(12, float(number)))
        robot.advance()
        return robot.plant.applied_torques.tolist()

    peer.say("fault", "[{kind: actuator_gain, actuator: FL_calf_joint, factor: 0.5, duration: 0.006}, "
             "{kind: command_loss, share: 1.0, start: 0.006, duration: 1.0}]")  # fmt: skip
    step(robot)
    found = np.array([applied(number) for number in range(1, 5)])
    assert found[:, [0, 2]].T.tolist() == [[1.0, 2.0, 2.0, 2.0], [0.5, 1.0, 2.0, 2.0]]
    peer.say("fault", "clear")
    step(robot)
    robot.plan(read_faults("{kind: command_twice, gap: 0.002, duration: 1.0}", "x"))
    assert [applied(number)[0] for number in range(1, 4)] == [1, 2, 3]  # the newest of two that arrive together


def test_sent_reports_the_true_time(stand):
    robot, _ = stand
    sent = []
    robot.sent = lambda stream, taken: sent.append((stream, taken))
    robot.plan(read_faults("{kind: message_delay, stream: joint_states, delay: 0.004, duration: 1.0}", "x"))
    step(robot, 4)
    assert [taken for stream, taken in sent if stream == "joint_states"] == [2_000_000, 4_000_000]
    assert [taken for stream, taken in sent if stream == "odom"] == [2_000_000, 4_000_000, 6_000_000, 8_000_000]


def test_faults_incompatible_with_lockstep_are_refused(go2):
    model, settings = go2
    robot = MockRobot(model, settings, MockPeer(MemoryBus(), settings).transport, lockstep=True)
    for kind in ("message_dropout", "stamp_zero", "command_loss"):
        with pytest.raises(InputRefused, match=f"{kind}: not possible in lockstep"):
            robot.plan(read_faults(f"{{kind: {kind}}}", "x"))
    robot.plan(read_faults("{kind: joint_noise}", "x"))


def test_a_script_acts_at_its_times_and_its_errors_have_its_path(go2, tmp_path):
    _, settings = go2
    script = tmp_path / "faults.yaml"
    script.write_text("- {at: 0.004, kind: joint_missing, duration: 0.004}\n", encoding="utf-8")
    peer, stop = MockPeer(MemoryBus(), settings), threading.Event()

    def received(content) -> None:
        if len(peer.all("joint_states")) >= 6:
            stop.set()

    peer.reactions["joint_states"] = received
    run_mock(settings, peer.transport, stop, real_time_factor=100.0, faults=script)
    assert [len(content.name) for content in peer.all("joint_states")][:6] == [12, 12, 11, 11, 12, 12]
    for text, said in (("- {kind: kick}", "'at'"), ("- {at: 1.0, kind: payload, link: x}", "unknown link 'x'")):
        script.write_text(text, encoding="utf-8")
        with pytest.raises(ConfigurationError, match=said) as error:
            run_mock(settings, MockPeer(MemoryBus(), settings).transport, threading.Event(), faults=script)
        assert str(error.value).startswith(str(script))
