"""The policy permits exactly the topics and services of the nodes."""

from xml.etree import ElementTree

import pytest
from command_line import wbc
from policies import read_policy
from services import make_estimator, make_guard

from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.controller import Controller
from wbc_controller.middleware.topics import ESTIMATOR_NODE, Direction
from wbc_controller.middleware.topics import GUARD_NODE as GUARD
from wbc_controller.middleware.topics import MOCK_NODE as MOCK
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.nodes.clock import ManualClock
from wbc_controller.nodes.controller_service import make_loop
from wbc_controller.nodes.ros2.command_outcomes import RECORD, SERVICES
from wbc_controller.nodes.ros2.security_policy import (
    CLOCK,
    LIFECYCLE_SERVES,
    NODE_PUBLISHES,
    NODE_SERVES,
    OPERATOR,
    security_policy,
)
from wbc_controller.nodes.wiring import controller_endpoints
from wbc_controller.simulation.mock_robot import MockRobot

CONTROLLER = "wbc_controller"
#: Valid children and attributes of each element by SROS 2's schema; `?` for optional attributes.
SCHEMA = {
    "policy": ({"enclaves"}, {"version"}),
    "enclaves": ({"enclave"}, set()),
    "enclave": ({"profiles"}, {"path"}),
    "profiles": ({"profile"}, set()),
    "profile": ({"topics", "services"}, {"ns", "node"}),
    "topics": ({"topic"}, {"publish?", "subscribe?"}),
    "services": ({"service"}, {"request?", "reply?"}),
    "topic": (set(), set()),
    "service": (set(), set()),
}


def opened(settings, model, namespace="/", remappings=None):
    """Return the names of published and of subscribed topics of each running node."""
    places = {"namespace": namespace, "remappings": remappings}
    buses = {node: MemoryBus() for node in (CONTROLLER, MOCK, GUARD)}
    controller, mock, guard = map(MemoryTransport, buses.values())
    topics = controller_endpoints(settings, model, **places)
    make_loop(Controller(settings, preflight=False, model=model), controller, ManualClock(), topics)
    for lockstep in (False, True):
        MockRobot(model, settings, mock, lockstep=lockstep, **places)
    make_guard(settings, model, guard, ManualClock(), **places)
    if model.floating_base:
        buses[ESTIMATOR_NODE] = MemoryBus()
        make_estimator(settings, model, MemoryTransport(buses[ESTIMATOR_NODE]), ManualClock(), **places)
    return {
        node: tuple({name for name, ends in by_name.items() if ends} for by_name in (bus.writers, bus.readers))
        for node, bus in buses.items()
    }


IMU = {"estimation": {"base_state": "imu", "absolute_pose": True}, "mock": {"pose_rate": 20.0}}


@pytest.mark.parametrize(
    ("name", "changes", "namespace", "remappings", "sensors"),
    [
        ("g1", {}, "/", None, {"odom"}),
        ("go2", {}, "/r1", {"odom": "/estimator/odom", "~/state": "mode"}, {"odom"}),
        ("go2", IMU, "/", None, {"imu", "pose", "measured_wrench"}),
        ("go2", {"robot": {"base": "fixed"}}, "/", None, set()),
        ("go2", {"control": {"markers_rate": 0.0}}, "/", None, {"odom"}),
    ],
)
def test_each_node_has_exactly_its_permissions(robot_of, changed, name, changes, namespace, remappings, sensors):
    settings = changed(robot_of(name)[0], changes)
    model = make_model(settings)
    allowed = read_policy(security_policy(settings, model, namespace, remappings))
    prefix = namespace.rstrip("/")
    nodes = opened(settings, model, namespace, remappings)
    assert set(allowed) == {f"{prefix}/{node}" for node in (*nodes, OPERATOR)}
    heard = {each.rpartition("/")[2] for each in nodes[CONTROLLER][1]}
    assert heard & {"imu", "odom", "pose", "measured_wrench"} == sensors
    of_feet = {name for _, heard in nodes.values() for name in heard if name.endswith(("/measured_wrench", "/holds"))}
    for node, (published, subscribed) in nodes.items():
        rules, own = allowed[f"{prefix}/{node}"], f"{prefix}/{node}/"
        lifecycle = node == CONTROLLER
        extra = {own + "transition_event"} if lifecycle else of_feet if node == MOCK else set()
        assert rules["publish"] == published | set(NODE_PUBLISHES) | extra
        assert rules["subscribe"] == subscribed | {CLOCK}
        serves = {*NODE_SERVES, *(LIFECYCLE_SERVES if lifecycle else ()), *((*SERVICES, RECORD) if lifecycle else ())}
        assert rules["reply"] == {own + service for service in serves}
        assert "request" not in rules


def test_the_operator_may_command_and_listen_but_not_play_the_robot(robot_of):
    settings, model = robot_of("g1")
    allowed = read_policy(security_policy(settings, model))
    rules = allowed["/operator"]
    nodes = opened(settings, model)
    commands = {name for name in nodes[CONTROLLER][1] if name.startswith("/wbc_controller/")}
    commands |= {"/cmd_vel", "/cmd_vel_stamped", "/wbc_controller/walk/goal", "/wbc_controller/walk/footsteps"}
    mock = {"push", "hold", "fault"} | {f"contacts/{contact}/grip" for contact in settings.contacts}
    assert rules["publish"] == commands | {f"/mock_robot/{name}" for name in mock} | set(NODE_PUBLISHES)
    assert not rules["publish"] & {"/effort_controller/commands", "/joint_states", "/odom", "/guard/state"}
    published = set().union(*(published for published, _ in nodes.values()))
    assert rules["subscribe"] == published | {"/rosout", CLOCK}
    assert rules["request"] == set().union(*(allowed[f"/{node}"]["reply"] for node in nodes))


def test_a_urdf_by_topic_is_permitted_and_markers_without_a_rate_are_not(robot_of, changed):
    settings, model = robot_of("go2")
    by_topic = changed(settings, {"robot": {"urdf": ""}, "control": {"markers_rate": 0.0}})
    allowed = read_policy(security_policy(by_topic, model))
    for node in ("/wbc_controller", "/guard"):
        assert "/robot_description" in allowed[node]["subscribe"]
    assert "/wbc_controller/markers" not in allowed["/wbc_controller"]["publish"]


def test_it_follows_the_schema_and_has_no_wildcard(robot_of):
    root = ElementTree.fromstring(security_policy(*robot_of("g1")))  # noqa: S314 - made by the code under test
    assert (root.tag, root.get("version")) == ("policy", "0.2.0")
    for element in root.iter():
        children, attributes = SCHEMA[element.tag]
        assert {child.tag for child in element} <= children
        assert len(element) or not children, f"<{element.tag}> is empty"
        required = {name for name in attributes if not name.endswith("?")}
        assert required <= set(element.attrib) <= {name.rstrip("?") for name in attributes}
        if element.tag in ("topic", "service"):
            assert element.text.startswith("/")
            assert "*" not in element.text
        elif element.tag in ("topics", "services"):
            assert set(element.attrib.values()) == {"ALLOW"}


def test_the_command_prints_it(robot_of):
    settings, model = robot_of("go2")
    result = wbc("security-policy", "go2", "--namespace", "/r1", "--remap", "odom:=/base")
    assert result.stdout == security_policy(settings, model, "/r1", {"odom": "/base"})


def test_every_incoming_row_has_a_permitted_publisher(robot_of, changed):
    """No enclave may publish unneeded names; the mock robot's enclave has all topics of the robot."""
    settings, model = robot_of("g1")
    heard = set()
    for source in ("odom", "imu"):
        estimation = {"base_state": source, "absolute_pose": True}
        allowed = read_policy(security_policy(changed(settings, {"estimation": estimation}), model))
        may_publish = set().union(*(rules["publish"] for rules in allowed.values()))
        heard |= (subscribed := allowed["/wbc_controller"]["subscribe"])
        assert subscribed - {"/clock"} <= may_publish
    incoming = {topic.name for topic in controller_endpoints(settings, model) if topic.direction is Direction.IN}
    assert incoming - heard <= {"/robot_description"}
