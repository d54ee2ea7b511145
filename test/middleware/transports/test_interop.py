"""The embedded DDS and a real ROS 2 exchange messages on every topic of the table."""

import dataclasses
import time
from contextlib import closing

import pytest
from participants import EVERY_TASK, DdsParticipants, Ros2Participants, is_omitted

from wbc_controller.middleware import topics
from wbc_controller.middleware.codec import decode, encode, message
from wbc_controller.middleware.topics import Direction, Endpoint, endpoints

pytestmark = pytest.mark.live


@pytest.fixture
def pair(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with (
        closing(Ros2Participants()) as ros2,
        closing(ros2.transport("on_ros2")) as on_ros2,
        closing(DdsParticipants().transport("on_dds")) as on_dds,
    ):
        yield on_ros2, on_dds


@pytest.mark.parametrize("to_dds", [True, False])
def test_every_row_crosses(pair, exchange, to_dds):
    writer, reader = pair if to_dds else reversed(pair)
    exchange(
        (dataclasses.replace(row, name=f"/{node}{row.name}"), writer, reader)  # some names are in several tables
        for node, table in topics.NODES.values()
        for row in endpoints(table, node, EVERY_TASK, frames=("pelvis",))
        if not is_omitted(row)
    )


def test_latched_message_reaches_a_late_subscriber(pair, eventually):
    heard = []
    for (writer, reader), name in zip((pair, pair[::-1]), ("/to_dds", "/to_ros2"), strict=True):
        topic = Endpoint("state", "", name, "std_msgs/msg/String", Direction.IN, topics.LATCHED)
        writer.advertise(topic)(encode(message(topic.type, data=name + "x" * 100_000)))
        heard.append([])
        reader.subscribe(topic, heard[-1].append)
    eventually(lambda: all(heard))
    assert [decode(said[0], topic.type).data.rstrip("x") for said in heard] == ["/to_dds", "/to_ros2"]
    assert [len(said[0]) > 100_000 for said in heard] == [True, True]


@pytest.mark.parametrize("to_dds", [True, False])
def test_each_names_the_publishers_of_the_other(pair, eventually, to_dds):
    writer, reader = pair if to_dds else reversed(pair)
    topic = Endpoint("effort", "", "/effort", "std_msgs/msg/String", Direction.OUT, topics.LATCHED)
    reader.advertise(topic)
    writer.advertise(topic)
    eventually(lambda: reader.publishers(topic) == ("/on_ros2" if to_dds else "/on_dds",))
    closed = time.monotonic()
    writer.close()
    eventually(lambda: reader.publishers(topic) == ())
    assert time.monotonic() - closed < 8.0  # the lease of a killed node ends after 10 s
