"""Discovery between ROS 2 nodes and the embedded DDS, by ROS 2's table of discovery ranges."""

import contextlib
import itertools
import subprocess
import sys
import textwrap
import time

import pytest
from domains import own_domain
from echo import endpoint, text
from network import DISCOVERY
from participants import Ros2Participants
from waiting import repeated

from wbc_controller.apps.terminal.session import Session
from wbc_controller.middleware.codec import diagnostics, encode
from wbc_controller.middleware.topics import LATCHED
from wbc_controller.middleware.transports.dds import DdsTransport
from wbc_controller.settings.config import load

pytestmark = pytest.mark.live

RANGES = ("", "LOCALHOST", "SUBNET")


@pytest.fixture
def set_range(monkeypatch):
    for name in DISCOVERY:
        monkeypatch.delenv(name, raising=False)
    return lambda value: monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", value)


def both_ways(embedded, ros, name):
    for wbc_transport, ros_transport in zip(embedded, ros, strict=True):
        yield endpoint(f"{name}/to_ros"), wbc_transport, ros_transport
        yield endpoint(f"{name}/to_wbc"), ros_transport, wbc_transport


def test_all_ranges_but_off_discover_each_other_on_one_host(set_range, exchange):
    """One embedded participant starts before the ROS 2 node, one after it; messages pass in both directions."""
    domains = {ranges: own_domain() for ranges in itertools.product(RANGES, RANGES)}
    with contextlib.ExitStack() as stack:

        def embedded(node):
            for (wbc_range, _), domain in domains.items():
                set_range(wbc_range)
                yield stack.enter_context(contextlib.closing(DdsTransport(node, domain_id=domain)))

        before, ros = list(embedded("before")), []
        time.sleep(0.5)  # until Cyclone has sent the announcements of its first 0.1 s
        for (_, ros_range), domain in domains.items():
            set_range(ros_range)
            participants = stack.enter_context(contextlib.closing(Ros2Participants(domain)))
            ros.append(stack.enter_context(contextlib.closing(participants.transport("ros"))))
        exchange(both_ways(before, ros, "/first"), seconds=20)
        exchange(both_ways(list(embedded("after")), ros, "/second"), seconds=20)


def test_a_session_hears_a_running_ros2_controller_within_its_patience(set_range, monkeypatch):
    """A new participant receives the latched state at once, not with Fast DDS's next heartbeat, 3 s later."""
    set_range("LOCALHOST")
    domain = own_domain()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    with (
        contextlib.closing(Ros2Participants(domain)) as ros,
        contextlib.closing(ros.transport("wbc_controller")) as controller,
    ):
        state = controller.advertise(endpoint("/wbc_controller/state", LATCHED))
        status = controller.advertise(endpoint("/diagnostics", type_name="diagnostic_msgs/msg/DiagnosticArray"))
        state(text("inactive"))
        report = encode(diagnostics(1, 0, "wbc_controller: control loop", "inactive", "go2", {}))
        with repeated(lambda: status(report), 0.1), Session(load("go2").settings) as session:
            session.wait_for_controller()
            assert session.mode() == "inactive"
            assert next(session.statuses()).message == "inactive"


_ROS_LISTENER = textwrap.dedent("""
    import sys, time, rclpy
    from std_msgs.msg import String
    rclpy.init()
    node = rclpy.create_node("stranger")
    heard = []
    node.create_subscription(String, sys.argv[2], heard.append, 1)
    end = time.monotonic() + float(sys.argv[1])
    while time.monotonic() < end and not heard:
        rclpy.spin_once(node, timeout_sec=0.1)
    print(len(heard) > 0)
""")
_WBC_SPEAKER = textwrap.dedent("""
    import sys, time
    from echo import DdsTransport, endpoint, text
    publish = DdsTransport("speaker").advertise(endpoint(sys.argv[1]))
    while True:
        publish(text("hello"))
        time.sleep(0.05)
""")


def test_ros2_nodes_of_another_host_hear_only_subnet(network):
    """Also with a ROS 2 node with SUBNET, discovered by the other host, beside the embedded DDS."""
    pytest.importorskip("rclpy")
    started = []

    def start(side, code, *words, discovery_range="SUBNET"):
        command = network.words(side, sys.executable, "-c", code, *words)
        environment = network.environment(ROS_DOMAIN_ID="7", ROS_AUTOMATIC_DISCOVERY_RANGE=discovery_range)
        started.append(subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True))
        return started[-1]

    try:
        start("robot", _ROS_LISTENER, "200", "/silence")
        start("robot", _WBC_SPEAKER, "/local", discovery_range="LOCALHOST")
        start("robot", _WBC_SPEAKER, "/subnet")
        cases = [("robot", "/local"), ("controller", "/subnet"), ("controller", "/local")]
        *others, last = [start(side, _ROS_LISTENER, "60", name) for side, name in cases]
        assert [listener.communicate(timeout=90)[0].strip() for listener in others] == ["True", "True"]
        time.sleep(2.0)
        assert last.poll() is None  # still listening in vain
    finally:
        for process in started:
            process.kill()
            process.communicate()


def test_subnet_without_a_network_card_uses_the_loopback(network):
    """Cyclone refuses to select the loopback twice: as the only interface, and by its address."""
    module = "wbc_controller.middleware.transports.dds"
    code = f"from {module} import DdsTransport; DdsTransport('a', discovery_range='SUBNET').close()"
    subprocess.run(network.words("robot", "ip", "link", "delete", "eth0"), check=True)
    words = network.words("robot", sys.executable, "-c", code)
    ended = subprocess.run(words, env=network.environment(), capture_output=True, text=True, timeout=60)
    assert ended.returncode == 0, ended.stderr
    assert "the loopback is the only network interface: topics stay on this computer" in ended.stderr
