"""The interface of all transports, run on each of them."""

import logging
import threading
import time

import numpy as np
import pytest
from echo import STRING, endpoint, text
from participants import EVERY_TASK, is_omitted

from wbc_controller.errors import TransportError
from wbc_controller.middleware import topics
from wbc_controller.middleware.codec import decode, encode, header, message, nanoseconds, time_fields
from wbc_controller.middleware.topics import Direction, counterpart, endpoints
from wbc_controller.nodes.clock import SimulatedClock

pytestmark = pytest.mark.live

ODOM = endpoint("/odom", topics.STATE_IN)


def texts(payloads):
    return [decode(payload, STRING).data for payload in payloads]


@pytest.mark.parametrize(("node", "table"), topics.NODES.values(), ids=topics.NODES)
def test_every_row_of_the_table_carries_its_message(request, join, exchange, node, table):
    owner, other = join(node), join("other")
    on_ros2 = request.node.callspec.params["join"] == "ros2"
    rows = endpoints(table, node, EVERY_TASK, frames=("pelvis",))

    def writer_and_reader(row):
        return (other, owner) if row.direction is Direction.IN else (owner, other)

    exchange((row, *writer_and_reader(row)) for row in rows if not (on_ros2 and is_omitted(row)))


def test_latched_topic_replays_its_last_message_to_a_late_subscriber_and_others_nothing(join, eventually):
    writer, reader, large = join("writer"), join("reader"), "<robot>" + "x" * 2_000_000
    publish, other = writer.advertise(endpoint("/state", topics.LATCHED)), writer.advertise(endpoint("/command"))
    for content in ("first", large):
        publish(text(content))
    other(text("early"))
    received, others = [], []
    reader.subscribe(endpoint("/state", topics.LATCHED), received.append)
    reader.subscribe(endpoint("/command"), others.append)
    eventually(lambda: received)
    assert texts(received) == [large]
    eventually(lambda: others, lambda: other(text("late")))
    assert set(texts(others)) == {"late"}


def test_burst_of_ten_requests_arrives_whole_and_in_order(join, eventually):
    publish = join("writer").advertise(endpoint("/command"))
    received = []
    join("reader").subscribe(endpoint("/command"), received.append)
    eventually(lambda: received, lambda: publish(text("are you there?")))
    publish(text("start"))
    eventually(lambda: texts(received)[-1] == "start")
    burst = [f"request {number}" for number in range(10)]
    for request in burst:
        publish(text(request))
    eventually(lambda: texts(received)[-10:] == burst)


def test_namespaces_do_not_mix(join, eventually):
    received = {"/a": [], "/b": []}
    publish = {}
    for namespace, messages in received.items():
        transport = join("node", namespace)
        transport.subscribe(endpoint(f"{namespace}/odom"), messages.append)
        publish[namespace] = transport.advertise(endpoint(f"{namespace}/odom"))
    eventually(lambda: received["/a"], lambda: publish["/a"](text("for a")))
    eventually(lambda: received["/b"], lambda: publish["/b"](text("for b")))
    assert set(texts(received["/a"])) == {"for a"}
    assert set(texts(received["/b"])) == {"for b"}


@pytest.mark.parametrize("join", ["dds", "ros2"], indirect=True)  # memory carries bytes of any type
def test_unknown_type_is_refused(join):
    with pytest.raises(TransportError, match="std_msgs/msg/Strin"):
        join("node").advertise(endpoint("/topic", type_name="std_msgs/msg/Strin"))


def test_nothing_arrives_after_close(join, eventually):
    writer, reader, witness = join("writer"), join("reader"), join("witness")
    publish = writer.advertise(endpoint("/command"))
    received, witnessed = [], []
    reader.subscribe(endpoint("/command"), received.append)
    witness.subscribe(endpoint("/command"), witnessed.append)
    eventually(lambda: received and witnessed, lambda: publish(text("x")))
    reader.close()
    reader.close()
    count = len(received)
    publish(text("after"))
    eventually(lambda: texts(witnessed)[-1] == "after")
    assert len(received) == count


def test_another_type_of_a_topic_is_refused_and_everything_after_close(join):
    transport = join("node")
    publish = transport.advertise(endpoint("/command"))
    with pytest.raises(TransportError, match=r"/command.*std_msgs/msg/String.*std_msgs/msg/Bool"):
        transport.subscribe(endpoint("/command", type_name="std_msgs/msg/Bool"), lambda payload: None)
    transport.close()
    with pytest.raises(TransportError, match="/command"):
        publish(text("x"))
    with pytest.raises(TransportError, match="/other"):
        transport.advertise(endpoint("/other"))
    with pytest.raises(TransportError, match="/other"):
        transport.subscribe(endpoint("/other"), lambda payload: None)


def test_callback_that_raises_is_logged_and_the_next_message_arrives(join, eventually, caplog):
    received = []

    def fail_once(payload):
        received.append(payload)
        if len(received) == 1:
            raise RuntimeError("deliberate")

    publish, reader = join("writer").advertise(endpoint("/command")), join("reader")
    reader.subscribe(endpoint("/command"), fail_once)
    log = logging.getLogger(type(reader).__module__)
    log.addHandler(caplog.handler)  # an installed ROS 2 launch keeps records from the root logger
    eventually(lambda: len(received) >= 2, lambda: publish(text("x")))
    log.removeHandler(caplog.handler)
    assert "callback for /command failed" in caplog.text
    assert "deliberate" in caplog.text


def test_topics_may_be_opened_and_messages_sent_from_a_callback(join, eventually):
    asking, answering = join("asking"), join("answering")
    answers = []
    asking.subscribe(endpoint("/answer"), answers.append)
    ask = asking.advertise(endpoint("/question"))
    answering.subscribe(endpoint("/question"), answering.advertise(endpoint("/answer")))
    eventually(lambda: answers, lambda: ask(text("x")))


def open_stream(join, eventually, depth=1):
    """Return a writer, its function to publish, and a stream from which the first messages are taken."""
    writer, stream = join("writer"), join("reader").stream(ODOM, depth)
    publish = writer.advertise(endpoint("/odom", topics.NEWEST_OUT))
    eventually(stream.take, lambda: publish(text("first")))
    time.sleep(0.05)  # messages in transit
    stream.take()
    return writer, publish, stream


def test_a_stream_keeps_the_newest_messages_until_they_are_taken(join, eventually):
    _, publish, stream = open_stream(join, eventually, 2)
    assert stream.take() == []
    for i in range(5):
        publish(text(str(i)))
    found = []
    eventually(lambda: found.extend(texts(stream.take())) or "4" in found, lambda: None)
    assert found[-2:] == ["3", "4"]
    assert stream.take() == []


def test_a_message_ends_the_wait_of_a_stream(join, eventually):
    _, publish, stream = open_stream(join, eventually)
    assert not stream.wait(0.0)
    assert not stream.wait(0.05)
    later = threading.Timer(0.1, lambda: publish(text("second")))
    later.start()
    assert stream.wait(20.0)
    assert stream.wait(0.0)  # until it is taken
    assert texts(stream.take()) == ["second"]
    assert not stream.wait(0.0)
    later.join()


def test_that_a_writer_is_gone_is_no_message(join, eventually):
    writer, _, stream = open_stream(join, eventually)
    writer.close()
    stream.wait(0.5)  # DDS reports it
    assert stream.take() == []


def test_wake_ends_the_wait_of_a_stream_and_a_stream_ends_with_its_transport(join):
    transport = join("reader")
    stream = transport.stream(ODOM, depth=1)
    stream.wake()
    assert stream.wait(20.0)
    assert not stream.wait(0.0)
    later = threading.Timer(0.1, stream.wake)
    later.start()
    assert stream.wait(20.0)
    assert stream.take() == []
    later.join()
    transport.close()
    with pytest.raises(TransportError, match="cannot read /odom: the transport is closed"):
        stream.take()
    with pytest.raises(TransportError, match="cannot read /odom: the transport is closed"):
        stream.wait(0.0)
    stream.wake()
    with pytest.raises(TransportError, match="/late"):
        transport.stream(endpoint("/late"), depth=1)


@pytest.fixture
def clock_and_writer(join):
    """A simulated clock, a function that publishes a time, ns, and the transports of their nodes."""
    reader, writer = join("reader"), join("writer")
    (topic,) = endpoints([topic for topic in topics.CONTROLLER_TOPICS if topic.key == "clock"], "reader")
    clock, publish = SimulatedClock([topic], reader), writer.advertise(counterpart(topic))
    tell = lambda time_ns: publish(encode(message("rosgraph_msgs/msg/Clock", clock=time_fields(time_ns))))  # noqa: E731
    return clock, tell, reader, writer


def test_the_simulated_time_is_read_while_the_transport_s_thread_is_busy(clock_and_writer, eventually):
    clock, tell, reader, writer = clock_and_writer
    began, shown = [], []

    def occupy_thread(payload):
        if began:
            return
        began.append(payload)
        deadline = time.monotonic() + 20.0
        while clock.now() != 7.0 and time.monotonic() < deadline:
            tell(7_000_000_000)
            time.sleep(0.005)
            clock.refresh()
        shown.append(clock.now())

    reader.subscribe(endpoint("/command"), occupy_thread)
    ask = writer.advertise(endpoint("/command"))
    eventually(lambda: shown, lambda: ask(text("x")))
    assert shown == [7.0]


def test_a_time_published_before_a_state_arrives_with_it(clock_and_writer, eventually):
    """Within a tenth of the limit of the stamps, because DDS does not order two topics."""
    clock, tell, reader, writer = clock_and_writer
    states, period = endpoint("/joint_states", topics.STATE_IN, "sensor_msgs/msg/JointState"), 2_000_000
    stream = reader.stream(states, depth=1)
    publish = writer.advertise(counterpart(states))
    empty = {"name": [], **dict.fromkeys(("position", "velocity", "effort"), np.zeros(0))}

    def send(time_ns):
        tell(time_ns)
        publish(encode(message(states.type, header=header(time_ns), **empty)))

    eventually(lambda: stream.take() and (clock.refresh() or clock.stamp()), lambda: send(period))
    late = []

    def simulate():
        for number in range(2, 400):
            send(number * period)
            time.sleep(0.001)

    simulator = threading.Thread(target=simulate)
    simulator.start()
    while simulator.is_alive():
        if stream.wait(0.05):
            taken = stream.take()
            clock.refresh()
            late += [nanoseconds(decode(payload, states.type).header.stamp) - clock.stamp() for payload in taken]
    simulator.join()
    assert len(late) > 50
    assert max(late) <= 5_000_000


def test_delivery_does_not_wait_for_a_poll(join, eventually):
    publish = join("writer").advertise(endpoint("/joint_states"))
    received = []
    join("reader").subscribe(endpoint("/joint_states"), lambda payload: received.append(time.perf_counter()))
    eventually(lambda: received, lambda: publish(text("x")))
    delays = []
    for _ in range(20):
        count, start = len(received), time.perf_counter()
        publish(text("x"))
        while len(received) == count and time.perf_counter() < start + 1:
            time.sleep(0.0005)
        delays.append(received[-1] - start)
    assert sorted(delays)[10] < 0.01


def test_the_other_nodes_that_publish_on_a_topic_are_named(join, eventually):
    own, other, third = join("controller"), join("estimator", "/a"), join("controller")
    odom = endpoint("/odom")
    own.advertise(odom)
    assert own.publishers(odom) == ()
    other.subscribe(odom, lambda payload: None)
    other.advertise(endpoint("/odometry"))
    publish = other.advertise(odom)
    eventually(lambda: own.publishers(odom) == ("/a/estimator",))
    third.advertise(odom)  # with the name of the asking node
    eventually(lambda: own.publishers(odom) == ("/a/estimator", "/controller"))
    eventually(lambda: other.publishers(odom) == ("/controller", "/controller"))
    assert own.publishers(endpoint("/nothing")) == ()
    publish(text("x"))
    other.close()
    eventually(lambda: own.publishers(odom) == ("/controller",))
    third.close()
    eventually(lambda: own.publishers(odom) == ())
    own.close()
    with pytest.raises(TransportError, match="/odom"):
        own.publishers(odom)


def test_has_reader(join, eventually):
    own, other = join("controller"), join("viewer", "/a")
    markers = endpoint("/markers")
    own.advertise(markers)
    own.advertise(endpoint("/odom"))
    assert not own.has_reader(markers)
    other.subscribe(markers, lambda payload: None)
    eventually(lambda: own.has_reader(markers))
    assert not own.has_reader(endpoint("/odom"))
    assert not own.has_reader(endpoint("/nothing"))
    assert not other.has_reader(markers)  # not advertised by it
    other.close()
    eventually(lambda: not own.has_reader(markers))
    own.close()
    with pytest.raises(TransportError, match="/markers"):
        own.has_reader(markers)
