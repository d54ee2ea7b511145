"""One owner of the robot: permitted publishers besides the controller, and reports of the others."""

import threading

import pytest

from wbc_controller.middleware.topics import counterpart
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.middleware.transports.transport import UNNAMED
from wbc_controller.nodes.ownership import Ownership
from wbc_controller.nodes.wiring import controller_endpoints


class Graph:
    """A controller in a namespace, and nodes that open its topics for writing."""

    def __init__(self, robot_of, allowed=("guard",), *, simulated=False):
        settings, model = robot_of("go2")
        self.bus = MemoryBus()
        self.topics = controller_endpoints(settings, model, namespace="/r1")
        own = self.node("wbc_controller", "effort")
        self.ownership = Ownership(own, self.topics, allowed, "/r1/wbc_controller", simulated=simulated)
        self.time = 0.0

    def node(self, name, *keys, namespace="/r1"):
        transport = MemoryTransport(self.bus, name, namespace)
        for topic in self.topics:
            if topic.key in keys:
                transport.advertise(topic if topic.key == "effort" else counterpart(topic))
        return transport

    def look(self):
        self.time += 1.0
        self.ownership.refresh(self.time)
        return self.ownership.contested


@pytest.fixture
def graph(robot_of):
    return lambda *words, **options: Graph(robot_of, *words, **options)


def test_one_robot_and_its_guard_are_as_it_should_be(graph):
    on = graph(simulated=True)
    on.node("mock_robot", "joint_states", "odom", "clock")
    on.node("guard", "effort")
    assert on.look() == ()
    assert on.ownership.shared == {}
    unused = graph(simulated=False)  # an unused clock may have any publishers
    unused.node("a", "clock")
    unused.node("b", "clock")
    assert unused.look() == ()


@pytest.mark.parametrize(
    ("name", "namespace"), [("wbc_controller", "/r1"), ("guard", "/r2"), ("guard", "/"), ("teleop", "/r1")]
)
def test_another_node_that_publishes_torques_is_named(graph, caplog, name, namespace):
    on = graph()
    rival = on.node(name, "effort", namespace=namespace)
    (sentence,) = on.look()
    assert sentence.startswith(f"torques on /r1/effort_controller/commands are published by {rival.name} too: stop it")
    assert "safety.torque_publishers" in sentence
    on.look()
    assert caplog.messages == [sentence]  # once
    rival.close()
    assert on.look() == ()


@pytest.mark.parametrize(
    ("allowed", "free"), [(["teleop"], True), (["/r1/teleop"], True), (["/teleop"], False), ([], False)]
)
def test_permitted_torque_publishers(graph, allowed, free):
    on = graph(allowed)
    on.node("teleop", "effort")
    assert bool(on.look()) is not free


@pytest.mark.parametrize(("key", "simulated"), [("odom", False), ("odom", True), ("clock", True)])
def test_two_sources_of_odometry_or_time_exclude_each_other(graph, key, simulated):
    on = graph(simulated=simulated)
    on.node("mock_robot", key)
    assert on.look() == ()
    on.node("estimator", key, namespace="/")
    (sentence,) = on.look()
    assert f"{key} has several publishers: /estimator, /r1/mock_robot; stop all but one" in sentence


def test_several_publishers_of_joint_states_are_permitted_and_reported(graph, caplog):
    on = graph()
    on.node("mock_robot", "joint_states")
    on.node("gripper", "joint_states")
    assert on.look() == ()
    assert on.ownership.shared == {"/r1/joint_states": "/r1/gripper, /r1/mock_robot"}
    on.look()
    assert caplog.messages == ["/r1/joint_states has several publishers: /r1/gripper, /r1/mock_robot"]


def test_in_lockstep_it_looks_four_times_a_second(graph, monkeypatch):
    on, looks = graph(), []
    monkeypatch.setattr(on.ownership._watch, "check", lambda: looks.append(1))
    for i in range(1000):
        on.ownership.refresh(0.002 * i)
    assert len(looks) == 8
    on.ownership.refresh(-1.0)  # the clock restarts
    assert len(looks) == 9


def test_a_loop_in_real_time_waits_until_the_others_are_discovered_and_looks_then(graph):
    on, waited = graph(), []

    class Stop:
        def wait(self, seconds):
            waited.append(seconds)
            on.node("wbc_controller", "effort")  # started at the same time

    on.ownership._discovered_at += 30.0
    on.ownership.start(Stop())
    on.ownership.stop()
    assert waited == [pytest.approx(30.0, abs=20.0)]
    assert len(on.ownership.contested) == 1


def test_a_publisher_that_was_there_before_counts_when_the_loop_begins(graph, monkeypatch):
    """Also if its name has not arrived yet."""
    on = graph()
    monkeypatch.setattr(MemoryTransport, "publishers", lambda transport, topic: (UNNAMED,) * (topic.key == "effort"))
    early = Ownership(MemoryTransport(on.bus), on.topics, [], "/r1/wbc_controller", simulated=False)
    assert early.contested == ()
    early.start(threading.Event())
    early.stop()
    assert "published by (a participant without a node name) too" in early.contested[0]
