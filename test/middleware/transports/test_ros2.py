"""The transport on rclpy: wake-ups of the executor, warnings about incompatible publishers, omitted topics."""

import importlib.util
import itertools
import logging
import time
from contextlib import ExitStack, closing
from types import SimpleNamespace

import pytest
from echo import STRING, endpoint, text
from participants import DOMAIN, DdsParticipants, Ros2Participants
from waiting import until

from wbc_controller.middleware import topics
from wbc_controller.middleware.codec import encode, message

try:
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import NodeNameNonExistentError
    from rclpy.parameter import Parameter
except ImportError as error:
    pytest.skip(f"rclpy is not importable: {error}", allow_module_level=True)

from wbc_controller.middleware.transports import ros2
from wbc_controller.middleware.transports.ros2 import Ros2Transport
from wbc_controller.nodes.ros2.process import Pacer, spinning

pytestmark = pytest.mark.live

TEXT = text("text")


class Counter(Pacer):
    """Counter of the waits of a node's executor, without a pause."""

    waits = 0

    def add_to_wait_set(self, wait_set):
        pass

    def is_ready(self, wait_set):
        self.waits += 1
        return False


@pytest.fixture
def spun(monkeypatch):
    """Make a spun node, its transport and the counter of its executor's waits."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    context, failures = rclpy.Context(), []
    rclpy.init(args=[], context=context, domain_id=DOMAIN)
    with ExitStack() as opened:
        opened.callback(context.try_shutdown)

        def spun(**parameters):
            overrides = [Parameter(name, value=value) for name, value in parameters.items()]
            node = rclpy.create_node("spun", context=context, parameter_overrides=overrides)
            opened.callback(node.destroy_node)
            counter, transport = Counter(), Ros2Transport(node)
            node.add_waitable(counter)
            opened.enter_context(spinning(SingleThreadedExecutor(context=context), node, failures.append))
            opened.callback(transport.close)
            return node, transport, counter

        yield spun
    assert failures == []


@pytest.fixture
def peer():
    """A transport of another process's kind."""
    with closing(DdsParticipants().transport("peer")) as transport:
        yield transport


def at_500_hz(publish, arrived, count=250):
    """Publish until a number of messages has arrived."""

    def advance():
        publish()
        time.sleep(0.002)

    until(lambda: arrived() >= count, f"{count} messages", advance=advance)


def test_messages_do_not_wake_the_executor(spun, peer):
    _, transport, counter = spun()
    received, streamed = [], []
    transport.subscribe(endpoint("/read", topics.STATE_IN), received.append)
    stream = transport.stream(endpoint("/stream", topics.STATE_IN), 10)
    publishers = [peer.advertise(endpoint(name, topics.NEWEST_OUT)) for name in ("/read", "/stream")]
    sent = transport.advertise(endpoint("/sent", topics.NEWEST_OUT))
    heard = []
    peer.subscribe(endpoint("/sent", topics.STATE_IN), heard.append)

    def publish():
        for each in (*publishers, sent):
            each(TEXT)
        streamed.extend(stream.take())

    def arrived():
        return min(map(len, (received, streamed, heard)))

    at_500_hz(publish, arrived, 1)  # all have discovered each other
    time.sleep(0.2)
    for each in (received, streamed, heard):
        each.clear()
    before = counter.waits
    at_500_hz(publish, arrived)
    assert counter.waits - before <= 2  # a late event of the discovery


def test_the_executor_pauses_between_two_waits(spun, peer):
    # rclpy's clock subscription belongs to the executor: with simulated time each message would wake it.
    clock = "rosgraph_msgs/msg/Clock"
    node, transport, counter = spun(use_sim_time=True)
    publish = peer.advertise(endpoint("/clock", topics.NEWEST_OUT, clock))
    arrived = []
    transport.subscribe(endpoint("/clock", topics.STATE_IN, clock), arrived.append)
    times = (
        encode(message(clock, clock=message("builtin_interfaces/msg/Time", sec=s, nanosec=0)))
        for s in itertools.count(1)
    )
    at_500_hz(lambda: publish(next(times)), lambda: len(arrived), 1)
    before, began, arrived[:] = counter.waits, time.monotonic(), []
    at_500_hz(lambda: publish(next(times)), lambda: len(arrived))
    waits, seconds = counter.waits - before, time.monotonic() - began
    assert 1 <= waits <= 1 + seconds / 0.02
    assert node.get_clock().now().nanoseconds >= 1_000_000_000


def test_wake_ups_without_a_callback_are_paced(spun):
    node, _, counter = spun()
    began = time.monotonic()
    for _ in range(200):
        node.executor.wake()
        time.sleep(0.002)
    assert 1 <= counter.waits <= 2 + (time.monotonic() - began) / 0.02


@pytest.fixture
def warned(monkeypatch, caplog, eventually):
    """Open a subscription and a publisher of another node; return the warnings."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setattr(ros2, "PERIOD", 0.02)
    caplog.set_level(logging.WARNING, "wbc_controller")
    participants = Ros2Participants(), Ros2Participants()  # on Fast DDS a topic has one type per participant
    reader, writer = (
        each.transport(name, "/ns") for each, name in zip(participants, ("reader", "writer"), strict=True)
    )

    def warned(subscription, publication, expected=1):
        writer.advertise(publication)
        eventually(lambda: reader.publishers(subscription) == ("/ns/writer",))
        reader.subscribe(subscription, lambda payload: None)
        eventually(lambda: len(caplog.messages) >= expected)
        time.sleep(0.2)  # about ten more checks
        return caplog.messages

    yield warned
    for each in (reader, writer, *participants):
        each.close()


def test_a_publisher_of_incompatible_quality_of_service_is_named_once(warned):
    (sentence,) = warned(endpoint("/state", topics.LATCHED), endpoint("/state", topics.STATE_IN))
    assert sentence.startswith("no messages on /state from /ns/writer: incompatible QoS (")
    assert "volatile publisher and transient local subscription" in sentence
    assert "best effort publisher and reliable subscription" in sentence
    assert sentence.endswith("; change the publisher's or qos_overrides./state.subscription")


def test_a_publisher_of_another_type_is_named_once(warned):
    other = endpoint("/command", topics.REQUEST, "std_msgs/msg/Bool")
    (sentence,) = warned(endpoint("/command", topics.REQUEST), other)
    assert sentence == ("no messages on /command from /ns/writer: type std_msgs/msg/Bool; publish std_msgs/msg/String")


def test_compatible_publishers_are_not_warned_of(warned):
    assert warned(endpoint("/odom", topics.STATE_IN), endpoint("/odom", topics.REQUEST), expected=0) == []


class GraphOfKilted:
    """Answers of a Kilted node's graph in which `bare` endpoints are of participants other than Fast DDS."""

    def __init__(self, bare, nodes):
        self._bare, self._nodes = bare, nodes

    def get_publishers_info_by_topic(self, topic):
        unknown = "_CREATED_BY_BARE_DDS_APP_"
        return [
            SimpleNamespace(node_name="own", node_namespace="/"),
            *self._bare * [SimpleNamespace(node_name=unknown, node_namespace=unknown)],
        ]

    def get_node_names_and_namespaces(self):
        return [("own", "/"), ("ended", "/"), *self._nodes]

    def get_publisher_names_and_types_by_node(self, name, namespace):
        if name == "ended":
            raise NodeNameNonExistentError
        return self._nodes.get((name, namespace), [("/effort", [STRING])])


@pytest.mark.parametrize(
    ("bare", "named"), [(0, ["/own"]), (1, ["/own", "/r1/dds"]), (2, [ros2.UNNAMED, "/own", "/r1/dds"])]
)
def test_publishers_that_kilted_does_not_name_are_named_by_the_topics_of_the_nodes(bare, named):
    nodes = {("dds", "/r1"): [("/effort", [STRING])], ("other", "/"): [("/state", [STRING])]}
    assert ros2.publisher_names(GraphOfKilted(bare, nodes), "/effort") == named


def test_tf_is_omitted_without_its_package(monkeypatch, caplog):
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *a: None if name == "tf2_msgs" else find(name, *a))
    tf = endpoint("/tf", topics.TF_OUT, "tf2_msgs/msg/TFMessage")
    with closing(Ros2Participants()) as participants, closing(participants.transport("node")) as transport:
        transport.advertise(tf)(b"")
        assert caplog.messages == ["/tf is not published: the package tf2_msgs is not installed"]
        assert not transport.has_reader(tf)
