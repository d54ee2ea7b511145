"""Waiting for the URDF on a topic."""

import contextlib
import itertools
import os
import threading
import time

import pytest
from busy import patience
from chains import joint, robot
from domains import own_domain
from forked import fork_wbc
from waiting import running

from wbc_controller import load
from wbc_controller.inverse_dynamics.robot.urdf import LARGEST_URDF
from wbc_controller.middleware.codec import encode, message
from wbc_controller.middleware.topics import CONTROLLER_TOPICS, LATCHED, Direction, Endpoint, counterpart, endpoints
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.nodes.urdf import wait_for_urdf

(ENDPOINT,) = endpoints([topic for topic in CONTROLLER_TOPICS if topic.key == "robot_description"], "wbc_controller")


@contextlib.contextmanager
def waiting(transport):
    """Wait for the URDF on a thread until the end of the block; yield the thread and the list of its result."""
    stop, found = threading.Event(), []
    with running(lambda: found.append(wait_for_urdf(transport, stop, [ENDPOINT])), stop=stop.set) as thread:
        yield thread, found


def text(content: str) -> bytes:
    return encode(message("std_msgs/msg/String", data=content))


def test_a_latched_urdf_comes():
    bus = MemoryBus()
    MemoryTransport(bus).advertise(counterpart(ENDPOINT))(text("<robot/>"))
    with waiting(MemoryTransport(bus)) as (thread, found):
        thread.join(10.0)
    assert found == ["<robot/>"]


def test_invalid_descriptions_are_refused_once_and_the_wait_continues(caplog):
    bus = MemoryBus()
    publish = MemoryTransport(bus).advertise(counterpart(ENDPOINT))
    with waiting(MemoryTransport(bus)) as (thread, found):
        publish(text("x" * (LARGEST_URDF + 20)))
        while not caplog.messages:
            time.sleep(0.005)
        for _ in range(3):
            publish(b"\0\1\0\0\xff\xff\xff\x7f")
            time.sleep(0.05)
        assert thread.is_alive()
        publish(text("x" * LARGEST_URDF))
        thread.join(10.0)
    assert found == ["x" * LARGEST_URDF]
    (refusal,) = caplog.messages
    assert refusal.startswith("refused /robot_description: URDF has 40000")
    assert refusal.endswith(f"bytes (limit {LARGEST_URDF})")


@pytest.mark.parametrize(
    ("publisher", "cause"),
    [
        (None, "no publisher"),
        ("description", "publisher /description must be latched (durability transient local), not volatile"),
    ],
)
def test_the_warning_names_the_probable_cause(caplog, monkeypatch, publisher, cause):
    monkeypatch.setattr("wbc_controller.nodes.urdf._WARNING_PERIOD", 0.01)
    bus = MemoryBus()
    if publisher is not None:
        MemoryTransport(bus, publisher).advertise(counterpart(ENDPOINT))
    with waiting(MemoryTransport(bus)):
        while not caplog.messages:
            time.sleep(0.005)
    assert caplog.messages[0] == f"robot.urdf is empty: still waiting for the URDF on /robot_description; {cause}"


@pytest.mark.live
@pytest.mark.parametrize("command", ["run", "guard"])
def test_a_urdf_from_the_network_that_pinocchio_would_not_survive_ends_in_a_sentence(command, tmp_path):
    from wbc_controller.middleware.transports.dds import DdsTransport

    domain, path, log = own_domain(), tmp_path / "go2.yaml", tmp_path / "log"
    path.write_text(load("go2").replace({"robot.urdf": ""}).to_yaml())
    names = [f"l{i}" for i in range(4000)]
    joints = (joint(f"j{i}", *pair, kind="fixed") for i, pair in enumerate(itertools.pairwise(names)))
    transport = DdsTransport("publisher", domain_id=domain, discovery_range="LOCALHOST")
    try:
        name, kind = "/robot_description", "std_msgs/msg/String"
        publish = transport.advertise(Endpoint("robot_description", "", name, kind, Direction.OUT, LATCHED))
        publish(text(robot(*(f'<link name="{name}"/>' for name in names), *joints)))
        environment = os.environ | {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        status = fork_wbc(environment, log, command, str(path)).wait(patience(60.0))
    finally:
        transport.close()
    assert status == 2
    assert log.read_text() == (
        f"error: {path}: robot.urdf: link 'l1000' is number 1001 in a chain of links; the maximum is 1000\n"
    )
