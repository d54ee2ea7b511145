"""The embedded DDS: types, environment, discovery, and other processes."""

import dataclasses
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from busy import patience
from echo import STRING, echo, endpoint, text
from forked import Forked, fork_wbc
from participants import DOMAIN, EVERY_TASK

from wbc_controller.errors import TransportError
from wbc_controller.middleware import topics
from wbc_controller.middleware.codec import decode, encode

pytest.importorskip("cyclonedds")

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from wbc_controller.middleware.transports import dds_raw
from wbc_controller.middleware.transports.dds import DdsTransport
from wbc_controller.middleware.transports.dds_domain import (
    DISCOVERY_RANGES,
    DomainSettings,
    configuration,
    domain_settings,
)
from wbc_controller.middleware.transports.dds_types import dds_type_name, idl_type, type_hash

pytestmark = pytest.mark.live

LOOPBACK = "<General><Interfaces><NetworkInterface address='127.0.0.1'/></Interfaces></General>"
INFO = "rmw_dds_common/msg/ParticipantEntitiesInfo"

ROWS = [row for node, table in topics.NODES.values() for row in topics.endpoints(table, node, EVERY_TASK)]
TABLE_TYPES = sorted({INFO, *(row.type for row in ROWS)})


@pytest.fixture
def transport():
    made = DdsTransport("node", domain_id=DOMAIN, discovery_range="LOCALHOST")
    yield made
    made.close()


@pytest.mark.parametrize("type_name", TABLE_TYPES)
def test_generated_type_describes_the_bytes_that_the_codec_writes(example, type_name):
    content = example(type_name)
    assert idl_type(type_name).__idl__.serialize(_with_lists(content), use_version_2=False) == encode(content)


def _with_lists(content):
    """Convert arrays into lists for cyclonedds."""
    if isinstance(content, np.ndarray):
        return content.tolist()
    if isinstance(content, list):
        return [_with_lists(element) for element in content]
    if hasattr(content, "__msgtype__"):
        fields = {field.name: _with_lists(getattr(content, field.name)) for field in dataclasses.fields(content)}
        return type(content)(**fields)
    return content


def test_type_name_and_hash_equal_ros2():
    transformed = idl_type("sensor_msgs/msg/JointState").__idl__.idl_transformed_typename
    assert dds_type_name("sensor_msgs/msg/JointState") == transformed == "sensor_msgs::msg::dds_::JointState_"
    assert type_hash(STRING) == "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({}, DomainSettings(0, "LOCALHOST")),
        ({"ROS_DOMAIN_ID": "", "ROS_AUTOMATIC_DISCOVERY_RANGE": ""}, DomainSettings(0, "LOCALHOST")),
        ({"ROS_DOMAIN_ID": "232"}, DomainSettings(232, "LOCALHOST")),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, DomainSettings(0, "SUBNET")),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF", "ROS_STATIC_PEERS": "h"}, DomainSettings(0, "OFF")),
        ({"ROS_STATIC_PEERS": "robot;;10.0.0.2"}, DomainSettings(0, "LOCALHOST", ("robot", "10.0.0.2"))),
        ({"ROS_LOCALHOST_ONLY": "1", "ROS_STATIC_PEERS": "robot"}, DomainSettings(0, "LOCALHOST")),
        ({"ROS_LOCALHOST_ONLY": "0"}, DomainSettings(0, "LOCALHOST")),
    ],
)
def test_environment(environment, expected):
    assert domain_settings(environment) == expected


def test_arguments_override_the_environment():
    environment = {"ROS_DOMAIN_ID": "nonsense", "ROS_AUTOMATIC_DISCOVERY_RANGE": "nonsense", "ROS_LOCALHOST_ONLY": "1"}
    assert domain_settings(environment, 7, "SUBNET") == DomainSettings(7, "SUBNET")


def test_bad_settings():
    for bad in ("-1", "233", "1.5", "x", "٣"):
        with pytest.raises(TransportError, match=rf"ROS_DOMAIN_ID is '{bad}'.*0 to 232"):
            domain_settings({"ROS_DOMAIN_ID": bad}, None)
    with pytest.raises(TransportError, match=r"233.*0 to 232"):
        domain_settings({}, 233)
    with pytest.raises(TransportError, match=r"'LOCAL'.*LOCALHOST, OFF, SUBNET, SYSTEM_DEFAULT"):
        domain_settings({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCAL"}, None)


def test_the_user_s_configuration_comes_last_and_peers_are_escaped():
    xml = configuration(DomainSettings(0, "LOCALHOST", ('a"&b',)), "file:///mine.xml")
    assert xml.endswith(",file:///mine.xml")
    assert "'a\"&amp;b'" in xml
    assert "<Discovery>" not in configuration(DomainSettings(0, "SYSTEM_DEFAULT"), "")
    assert "NetworkInterface" in configuration(DomainSettings(0, "LOCALHOST"), "file:///nowhere/x.xml")
    assert "127.0.0.1" not in configuration(DomainSettings(0, "LOCALHOST"), LOOPBACK).removesuffix(LOOPBACK)


@pytest.mark.parametrize("discovery_range", DISCOVERY_RANGES)
def test_types_of_fast_dds_are_ignored_and_packets_sent_again_and_peers_announced_to_for_ever(discovery_range):
    """Cyclone refuses the arrays and sequences that rmw_fastrtps announces from Kilted on; Jazzy announces none.

    Without the interval, Cyclone waits for 100 ms: `wbc fuzz floods --kinds large` beside other load shows it.
    """
    xml = configuration(DomainSettings(0, discovery_range, ("robot",)))
    assert "<IgnoreTypeInformation>1.15</IgnoreTypeInformation>" in xml
    assert discovery_range == "SYSTEM_DEFAULT" or "<HeartbeatInterval>10 ms</HeartbeatInterval>" in xml
    if discovery_range in ("LOCALHOST", "SUBNET"):  # Cyclone's default ends announcements without an answer after 30 s
        assert '<Peer Address="localhost" PruneDelay="inf"/><Peer Address="robot" PruneDelay="inf"/>' in xml
        assert "<SPDPInterval>1 s</SPDPInterval>" in xml


@pytest.mark.parametrize("domain_id", [0, 101, 232])
@pytest.mark.parametrize("discovery_range", DISCOVERY_RANGES)
def test_every_configuration_is_accepted_by_cyclone(domain_id, discovery_range, monkeypatch):
    if discovery_range in ("SUBNET", "SYSTEM_DEFAULT"):
        monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)  # the same configuration, limited to this computer
    DdsTransport("node", domain_id=domain_id, discovery_range=discovery_range).close()


def test_domain_has_one_range_per_process_until_it_is_closed():
    first = DdsTransport("first", domain_id=DOMAIN, discovery_range="LOCALHOST")
    with pytest.raises(TransportError, match="other settings"):
        DdsTransport("second", domain_id=DOMAIN, discovery_range="OFF")
    first.close()
    DdsTransport("third", domain_id=DOMAIN, discovery_range="OFF").close()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the names of threads are Linux's")
def test_a_thread_reads_the_socket_of_all_data_alone(transport, eventually):
    names = Path("/proc/self/task").glob
    eventually(lambda: "recvUC\n" in [path.read_text(encoding="ascii") for path in names("*/comm")])


def test_bad_configuration_of_the_user_is_named(monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", "<General><Nonsense/></General>")
    with pytest.raises(TransportError, match="Nonsense"):
        DdsTransport("node", domain_id=DOMAIN, discovery_range="LOCALHOST")


@pytest.mark.parametrize(
    "uri",
    [
        "",
        LOOPBACK,
        "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo' priority='1'/></Interfaces></General>"
        "</Domain></CycloneDDS>",
        "file://{file}",
        "<Tracing><Verbosity>severe</Verbosity><OutputFile>stderr</OutputFile></Tracing>,file://{file}",
    ],
)
def test_two_processes_exchange_over_a_loopback_that_the_user_may_configure_too(uri, monkeypatch, tmp_path, eventually):
    (tmp_path / "loopback.xml").write_text(f"<CycloneDDS><Domain>{LOOPBACK}</Domain></CycloneDDS>")
    monkeypatch.setenv("CYCLONEDDS_URI", uri.format(file=tmp_path / "loopback.xml"))
    here = DdsTransport("here", domain_id=DOMAIN, discovery_range="LOCALHOST")
    monkeypatch.delenv("CYCLONEDDS_URI")
    urdf, pongs, urdfs = text("x" * 2_000_000), [], []
    here.subscribe(endpoint("/pong"), pongs.append)
    here.subscribe(endpoint("/urdf_back", topics.LATCHED), urdfs.append)
    here.advertise(endpoint("/urdf", topics.LATCHED))(urdf)
    ping, stop = here.advertise(endpoint("/ping")), here.advertise(endpoint("/stop"))
    other = Forked(os.environ, tmp_path / "log", echo, DOMAIN)  # without that configuration
    eventually(lambda: pongs, lambda: ping(text("hello")))
    eventually(lambda: urdfs)
    eventually(lambda: other.poll() is not None, lambda: stop(text("")))
    assert decode(pongs[0], STRING).data == "hello"
    assert decode(urdfs[0], STRING) == decode(urdf, STRING)
    assert other.returncode == 0
    here.close()


ENFORCED = {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce"}


@pytest.mark.parametrize("command", ["run", "mock", "guard"])
def test_the_commands_refuse_enforced_security(command, tmp_path):
    environment = os.environ | ENFORCED | {"ROS_DOMAIN_ID": str(DOMAIN)}
    assert fork_wbc(environment, tmp_path / "log", command, "go2").wait(patience(30.0)) == 2
    (line,) = (tmp_path / "log").read_text().splitlines()
    assert line.startswith("error: ROS_SECURITY_ENABLE is true and ROS_SECURITY_STRATEGY is Enforce, but the em")


@pytest.mark.parametrize("environment", [{"ROS_SECURITY_ENABLE": "true"}, ENFORCED | {"ROS_SECURITY_ENABLE": "false"}])
def test_permissive_security_is_a_warning(environment, caplog):
    domain_settings(environment)
    assert ["does not support security" in line for line in caplog.messages] == [True] * (
        environment["ROS_SECURITY_ENABLE"] == "true"
    )


def test_other_hosts_are_discovered_only_with_subnet(network):
    subnet = network.environment(ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET")
    for own, seconds, heard in ((network.environment(), 3.0, "False"), (subnet, 20.0, "True")):
        words = network.words("robot", sys.executable, "-c", "import echo; echo.echo(7, None)")
        with subprocess.Popen(words, env=own) as other:
            asked = subprocess.run(
                network.words("controller", sys.executable, "-c", f"import echo; echo.ask(7, {seconds})"),
                env=subnet, capture_output=True, text=True, timeout=60,
            )  # fmt: skip
            other.kill()
        assert asked.stdout.strip() == heard, asked.stderr


@pytest.mark.parametrize("payload", [b"", b"\0\1\0", b"\0\1\0\0", b"\0\1\0\0\xff\xff\xff\xff"])
def test_bytes_that_are_no_message_are_refused(transport, payload):
    publish = transport.advertise(endpoint("/topic"))
    with pytest.raises(TransportError, match="/topic"):
        publish(payload)


def test_close_from_a_callback_is_refused_and_the_transport_lives(transport, eventually):
    errors = []

    def close(payload):
        try:
            transport.close()
        except TransportError as error:
            errors.append(error)

    publish = transport.advertise(endpoint("/topic"))
    transport.subscribe(endpoint("/topic"), close)
    eventually(lambda: len(errors) >= 2, lambda: publish(text("x")))


def test_node_and_its_endpoints_are_announced(eventually):
    transport = DdsTransport("wbc_controller", "/robot", DOMAIN, "LOCALHOST")
    transport.advertise(endpoint("/robot/state", topics.LATCHED))
    transport.subscribe(endpoint("/robot/command"), lambda payload: None)
    observer = DomainParticipant(DOMAIN)
    qos = Qos(Policy.Reliability.Reliable(0), Policy.Durability.TransientLocal, Policy.History.KeepLast(1))
    reader = DataReader(observer, Topic(observer, "ros_discovery_info", idl_type(INFO)), qos)
    announced = []
    eventually(lambda: announced, lambda: announced.extend(dds_raw.take(reader, 10)))
    info = decode(announced[-1], INFO)
    (node,) = info.node_entities_info_seq
    assert (node.node_namespace, node.node_name) == ("/robot", "wbc_controller")
    assert len(node.reader_gid_seq) == len(node.writer_gid_seq) == 1
    gids = [bytes(info.gid.data), bytes(node.reader_gid_seq[0].data), bytes(node.writer_gid_seq[0].data)]
    assert len(set(gids)) == 3
    assert len({gid[:12] for gid in gids}) == 1  # endpoints share their participant's prefix
    for entity in (reader, observer):
        dds_raw.delete(entity)
    transport.close()


def test_topics_may_be_opened_while_others_close_and_publish(eventually):
    here, there = (DdsTransport(name, domain_id=DOMAIN, discovery_range="LOCALHOST") for name in ("here", "there"))
    received, refused = [], []

    def open_another(payload):
        received.append(payload)
        try:
            there.subscribe(endpoint(f"/topic_{len(received)}"), received.append)
        except TransportError as error:
            refused.append(error)

    there.subscribe(endpoint("/topic"), open_another)
    publish = here.advertise(endpoint("/topic"))
    with ThreadPoolExecutor(3) as pool:
        pool.map(lambda _: [publish(text("x")) for _ in range(200)], range(3))
        eventually(lambda: received)
        there.close()
        count = len(received)
    assert len(received) == count
    here.close()
