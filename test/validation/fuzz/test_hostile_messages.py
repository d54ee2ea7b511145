"""Fuzzer of messages: the nodes pass; injected defects are detected, written and reproduced."""

import dataclasses
import gc
import time
import weakref

import numpy as np
import pytest
from command_line import wbc
from hypothesis import strategies as st
from refusals import refusal

from wbc_controller.controller.cycle import ControlCycle
from wbc_controller.estimation.base_estimator import BaseEstimator
from wbc_controller.inverse_dynamics.references.board import ReferenceBoard
from wbc_controller.middleware import decoding, topics
from wbc_controller.middleware.codec import decode, encode, message
from wbc_controller.nodes.inputs import Inputs
from wbc_controller.nodes.requests import Requests
from wbc_controller.safety.guard import Guard
from wbc_controller.safety.supervisor import Supervisor
from wbc_controller.validation.fuzz import hostile_messages
from wbc_controller.validation.fuzz.controller_target import ControllerTarget
from wbc_controller.validation.fuzz.hostile_messages import TARGETS, fuzz_messages, load, replay
from wbc_controller.validation.fuzz.other_targets import UrdfTarget
from wbc_controller.validation.fuzz.strategies import draw_by_key
from wbc_controller.validation.fuzz.target import Target, collected_errors, fuzzed_robot

ROBOT = "go2"
#: Number of messages; `wbc fuzz messages` sends a million.
COUNT = 1100
TABLES = {
    "controller": topics.CONTROLLER_TOPICS, "guard": topics.GUARD_TOPICS, "mock": topics.MOCK_TOPICS,
    "estimator": topics.ESTIMATOR_TOPICS,
}  # fmt: skip


def test_nodes_survive_hostile_messages(monkeypatch):
    monkeypatch.setattr(hostile_messages, "_EPISODE_LENGTH", 200)
    outcome = fuzz_messages(ROBOT, COUNT, 0)
    assert [f"{failure.target}: {failure.why}" for failure in outcome.failures] == []
    assert outcome.sent == COUNT
    rows = [(node, row) for node, table in TABLES.items() for row in table if row.direction is topics.Direction.IN]
    wanted = {f"{node}: {row.key}" for node, row in rows if row.key != "robot_description"}
    assert set(outcome.counts) == wanted | {"urdf: robot_description"}


def test_valid_requests_are_accepted_by_tasks_of_every_type():
    assert {task.type for task in fuzzed_robot("g1")[0].tasks.values()} == set(topics.TASK_TYPES)
    target = ControllerTarget("g1")
    others = ("joint_states", "odom", "clock", "command", "update")
    with collected_errors() as errors:  # without garbage collections, whose time would count
        for topic in [topic for topic in target.topics.values() if topic.key not in others]:
            target.deliver(topic, encode(target.example(topic)))
            assert not target._refused, topic.name
    assert not errors


def test_unexplained_motion_after_a_false_external_wrench_sends_zeros_at_once():
    target = ControllerTarget("g1")
    topic = target.topics["/wbc_controller/external_wrenches/right_rubber_hand"]
    content = target.example(topic)
    content.wrench.force.z = 3000.0
    with collected_errors():
        target.deliver(topic, encode(content))
        while target.alive and target._robot.clock.now() < 0.1:
            target._cycle("a false wrench", publish=True)
            target.finish()
    assert target._controller.fault.code == "UNEXPLAINED_MOTION"
    assert not target._tau.any()


def test_seed_determines_the_messages(monkeypatch):
    def sent(seed):
        messages = []
        with monkeypatch.context() as patch:
            patch.setattr(UrdfTarget, "deliver", lambda self, topic, payload: messages.append(payload))
            assert not fuzz_messages(ROBOT, 20, seed, targets=["urdf"]).failures
        return messages

    first = sent(3)
    assert first == sent(3)
    assert len({*first, *sent(4)}) > 25


@pytest.mark.parametrize("key", TARGETS)
def test_nodes_end_with_their_episode(key, monkeypatch):
    """Memory of one robot per episode would hide a leak of the node."""
    draw_by_key(st.integers())  # Hypothesis keeps the first strategy of the process
    nodes, original = weakref.WeakSet(), Target.__init__

    def init(self, *arguments):
        nodes.add(self)
        original(self, *arguments)

    monkeypatch.setattr(Target, "__init__", init)
    fuzz_messages(ROBOT, 20, 1, targets=[key])
    gc.collect()
    assert not list(nodes)


def _jumps(update_time, supervisor, now):
    supervisor._rate.fill(np.inf)


def _stops(decode, requests, endpoint, payload):
    read = decode(requests, endpoint, payload)
    if read.refused:
        requests._estop.set()
    return read


def _answers(decode, inputs, queue, refused):
    decode(inputs, queue, refused)
    if refused and inputs.estimator is not None and inputs.estimator.base is not None:
        running, stamp = inputs.estimator._running, inputs.estimator.stamp + 1e-6
        running._last = dataclasses.replace(running._last, stamp=stamp)


def _exceeds(take_over, guard, now, outputs):
    take_over(guard, now, outputs)
    guard._tau = np.full(len(guard._tau), 1.0e4)


@pytest.mark.parametrize(
    ("owner", "name", "broken", "node", "count", "why"),
    [
        (Requests, "_decode", _stops, "controller", 100, "was used"),
        (Supervisor, "_update_time", _jumps, "controller", 1500, "the torque step"),
        (Inputs, "_decode", _answers, "estimator", 200, "was refused"),
        (Guard, "_take_over", _exceeds, "guard", 200, "the guard exceeded a torque limit"),
        (BaseEstimator, "covariance", None, "estimator", 200, "invalid covariance of the estimate"),
    ],
)
def test_nodes_with_defects_are_found(monkeypatch, owner, name, broken, node, count, why):
    original = getattr(owner, name)
    covariance = -np.eye(6), np.eye(6)
    changed = (lambda *arguments: broken(original, *arguments)) if broken else covariance
    monkeypatch.setattr(owner, name, changed)
    (failure,) = fuzz_messages(ROBOT, count, 2, targets=[node], most_failures=1).failures
    assert why in failure.why


def test_a_message_that_takes_long_is_found(monkeypatch):
    def slow(vocabulary, subject, content):
        end = time.thread_time() + 0.1
        while time.thread_time() < end:
            pass
        return ()

    monkeypatch.setattr("wbc_controller.validation.fuzz.controller_target.READ_LIMIT", 0.05)
    monkeypatch.setitem(decoding.READERS, "weight", slow)
    (failure,) = fuzz_messages(ROBOT, 1500, 2, targets=["controller"], most_failures=1).failures
    assert "ms of processor time; limit 50 ms" in failure.why


def test_refused_messages_that_change_reference_or_mode_are_found(monkeypatch):
    check, cycle, target = ReferenceBoard.check, ControlCycle.cycle, ControllerTarget(ROBOT)

    def applies(self, change, dynamics, time):
        self._apply(change, dynamics, time)
        check(self, change, dynamics, time)

    def damps(self, inputs):
        result = cycle(self, inputs)
        if any("is unknown" in sentence for sentence in result.refused):
            self.supervisor.request("damp", 0.0, None)
        return dataclasses.replace(result, mode=self.mode)

    trajectory, command = (target.topics[f"/wbc_controller/{name}"] for name in ("tasks/com/trajectory", "command"))
    content = target.example(trajectory)
    content.header.stamp.nanosec = 1
    for point in content.points:
        point.time_from_start.sec, point.time_from_start.nanosec = 0, 1_000_000 * point.time_from_start.sec
    with monkeypatch.context() as patch:
        patch.setattr(ReferenceBoard, "check", applies)
        why = replay("controller", ROBOT, [(trajectory.name, encode(content))])
    assert (why or "").startswith("refused messages changed board_trajectories.com")
    monkeypatch.setattr(ControlCycle, "cycle", damps)
    why = replay("controller", ROBOT, [(command.name, encode(message("std_msgs/msg/String", data="actvate")))])
    assert (why or "").startswith("refused messages led from active to damping")


def test_invalid_failure_files_and_nodes_are_refused(tmp_path):
    path = tmp_path / "none.json"
    for text in ("", "{}", "[1]", '{"messages": [{"topic": "/a", "payload": 3}]}'):
        path.write_text(text)
        assert "not a file of fuzzer messages" in refusal(load, path)
    said = "unknown node 'controler'; did you mean 'controller'? Valid: controller, estimator, guard, mock, urdf"
    assert said in wbc("fuzz", "messages", "--nodes", "controler", status=2).output


def test_command_reports_messages_and_saves_failures_for_replay(tmp_path, monkeypatch):
    """One message is enough to find a reader that raises."""

    def broken(vocabulary, subject, content):
        raise KeyError("weight")

    options = ("--count", "50", "--seed", "2", "--nodes", "controller", "--out", tmp_path)
    with monkeypatch.context() as patch:
        patch.setitem(decoding.READERS, "weight", broken)
        result = wbc("fuzz", "messages", *options, status=1)
        (path, *_) = sorted(tmp_path.iterdir())
        assert "controller, 1 messages: logged error: decoding a message on /wbc_controller/tasks/" in result.output
        assert f"--replay {path}" in result.output
        assert "KeyError: 'weight'" in wbc("fuzz", "messages", "--replay", path, status=1).output
    assert wbc("fuzz", "messages", "--replay", path).output == "controller, 1 messages: no failure\n"
    node, robot, ((_, payload),) = load(path)
    assert (node, robot) == ("controller", ROBOT)
    assert decode(payload, "std_msgs/msg/Float64") is not None
