"""Discovery between ROS 2 nodes and the embedded DDS, by ROS 2's table of discovery ranges."""

import os
import subprocess
import sys
import textwrap
import threading
import time

import pytest
from domains import own_domain
from participants import Ros2Participants

from wbc_controller.apps.terminal.session import Session
from wbc_controller.middleware.codec import decode, diagnostics, encode, message
from wbc_controller.middleware.topics import LATCHED, REQUEST, Direction, Endpoint
from wbc_controller.middleware.transports.dds import DdsTransport
from wbc_controller.settings.config import load

pytestmark = pytest.mark.live

STRING = "std_msgs/msg/String"
RANGES = ("", "LOCALHOST", "SUBNET")
#: Shell variables that would affect the test.
_SHELL = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY", "ROS_STATIC_PEERS", "CYCLONEDDS_URI")


def topic(name, qos=REQUEST, type_name=STRING):
    return Endpoint("test", "", name, type_name, Direction.IN, qos)


@pytest.fixture
def set_range(monkeypatch):
    for name in _SHELL:
        monkeypatch.delenv(name, raising=False)
    return lambda value: monkeypatch.setenv(_SHELL[0], value)


def exchange(wbc, ros, name, eventually):
    """Send messages in both directions until both arrive."""
    heard_by_ros, heard_by_wbc = [], []
    ros.subscribe(topic(f"{name}/to_ros"), heard_by_ros.append)
    wbc.subscribe(topic(f"{name}/to_wbc"), heard_by_wbc.append)
    to_ros, to_wbc = wbc.advertise(topic(f"{name}/to_ros")), ros.advertise(topic(f"{name}/to_wbc"))

    def speak():
        to_ros(encode(message(STRING, data="wbc")))
        to_wbc(encode(message(STRING, data="ros")))

    eventually(lambda: heard_by_ros and heard_by_wbc, speak, seconds=20)
    assert decode(heard_by_ros[0], STRING).data == "wbc"
    assert decode(heard_by_wbc[0], STRING).data == "ros"


@pytest.mark.parametrize("wbc_range", RANGES, ids=lambda value: f"wbc_{value or 'unset'}")
@pytest.mark.parametrize("ros_range", RANGES, ids=lambda value: f"ros_{value or 'unset'}")
def test_all_ranges_but_off_discover_each_other_on_one_host(ros_range, wbc_range, set_range, eventually):
    """One embedded participant starts before the ROS 2 node, one after it; messages pass in both directions."""
    domain = own_domain()
    opened = []

    def embedded(node):
        set_range(wbc_range)
        opened.append(DdsTransport(node, domain_id=domain))
        return opened[-1]

    before = embedded("before")
    time.sleep(0.5)  # until Cyclone has sent the announcements of its first 0.1 s
    set_range(ros_range)
    ros = Ros2Participants(domain)
    try:
        opened.append(ros.transport("ros"))
        exchange(before, opened[1], "/first", eventually)
        exchange(embedded("after"), opened[1], "/second", eventually)
    finally:
        for transport in opened:
            transport.close()
        ros.close()


def test_a_session_hears_a_running_ros2_controller_within_its_patience(set_range, monkeypatch):
    """A new participant receives the latched state at once, not with Fast DDS's next heartbeat, 3 s later."""
    set_range("LOCALHOST")
    domain = own_domain()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    ros = Ros2Participants(domain)
    try:
        controller = ros.transport("wbc_controller")
        state = controller.advertise(topic("/wbc_controller/state", LATCHED))
        status = controller.advertise(topic("/diagnostics", type_name="diagnostic_msgs/msg/DiagnosticArray"))
        state(encode(message(STRING, data="inactive")))
        ended = threading.Event()

        def diagnose():
            while not ended.wait(0.1):
                status(encode(diagnostics(1, 0, "wbc_controller: control loop", "inactive", "go2", {})))

        thread = threading.Thread(target=diagnose)
        thread.start()
        try:
            with Session(load("go2").settings) as session:
                session.wait_for_controller()
                assert session.mode() == "inactive"
                assert next(session.statuses()).message == "inactive"
        finally:
            ended.set()
            thread.join()
            controller.close()
    finally:
        ros.close()


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
    import time
    from test_discovery import DdsTransport, STRING, encode, message, topic
    publish = DdsTransport("speaker").advertise(topic("/said"))
    while True:
        publish(encode(message(STRING, data="hello")))
        time.sleep(0.05)
""")


def test_ros2_nodes_of_another_host_hear_only_subnet(network):
    """Also with a ROS 2 node with SUBNET, discovered by the other host, beside the embedded DDS."""
    pytest.importorskip("rclpy")
    environment = {name: value for name, value in os.environ.items() if name not in _SHELL}
    environment |= {
        "PYTHONPATH": os.pathsep.join([os.path.dirname(__file__), *filter(None, sys.path)]),
        "ROS_DOMAIN_ID": "7",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
    }

    def start(side, code, *arguments, **changes):
        words = network.words(side, sys.executable, "-c", code, *arguments)
        return subprocess.Popen(words, env=environment | changes, stdout=subprocess.PIPE, text=True)

    def hears(side, patience):
        return start(side, _ROS_LISTENER, str(patience), "/said").communicate(timeout=90)[0].strip() == "True"

    started = [start("robot", _ROS_LISTENER, "200", "/silence")]
    try:
        started.append(start("robot", _WBC_SPEAKER, ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST"))
        assert hears("robot", 40)
        assert not hears("controller", 5)
        started.pop().kill()
        started.append(start("robot", _WBC_SPEAKER))
        assert hears("controller", 40)
    finally:
        for process in started:
            process.kill()


def test_subnet_without_a_network_card_uses_the_loopback(network):
    """Cyclone refuses to select the loopback twice: as the only interface, and by its address."""
    environment = {name: value for name, value in os.environ.items() if name not in _SHELL}
    module = "wbc_controller.middleware.transports.dds"
    code = f"from {module} import DdsTransport; DdsTransport('a', discovery_range='SUBNET').close()"
    subprocess.run(network.words("robot", "ip", "link", "delete", "eth0"), check=True)
    words = network.words("robot", sys.executable, "-c", code)
    ended = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=60)
    assert ended.returncode == 0, ended.stderr
    assert "the loopback is the only network interface: topics stay on this computer" in ended.stderr
