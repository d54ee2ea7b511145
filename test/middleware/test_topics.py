"""The topic table: names, types, directions, quality of service, and use of every row."""

from types import SimpleNamespace

import pytest

from wbc_controller.errors import ConfigurationError
from wbc_controller.middleware import topics
from wbc_controller.middleware.codec import TYPES
from wbc_controller.middleware.decoding import READERS
from wbc_controller.settings.files import types_of
from wbc_controller.settings.tasks import TaskSettings

KINDS = {"com": "com", "hand": "frame_pose", "posture": "posture"}
SETTINGS = SimpleNamespace(
    tasks={name: SimpleNamespace(type=kind) for name, kind in KINDS.items()}, contacts=("left", "right")
)


def expand(table=topics.CONTROLLER_TOPICS, **changes):
    made = topics.endpoints(table, "wbc", **{"settings": SETTINGS, "frames": ("pelvis",), **changes})
    return {(endpoint.key, endpoint.subject): endpoint for endpoint in made}, made


@pytest.mark.parametrize(
    ("name", "namespace", "remappings", "expected"),
    [
        ("odom", "/", None, "/odom"),
        ("odom", "/robot", None, "/robot/odom"),
        ("odom", "/robot/", None, "/robot/odom"),
        ("/odom", "/robot", None, "/odom"),
        ("~/state", "/", None, "/wbc/state"),
        ("~/state", "/a/b", None, "/a/b/wbc/state"),
        ("~", "/a", None, "/a/wbc"),
        ("~state", "/a", None, "/a/~state"),
        ("odom", "/robot", {"odom": "estimator/odom"}, "/robot/estimator/odom"),
        ("odom", "/robot", {"odom": "/estimator/odom"}, "/estimator/odom"),
        ("odom", "/robot", {"/robot/odom": "/o"}, "/o"),
        ("odom", "/robot", {"/odom": "/o"}, "/robot/odom"),
        ("~/state", "/robot", {"~/state": "~/mode"}, "/robot/wbc/mode"),
        ("~/state", "/robot", {"/robot/wbc/state": "mode"}, "/robot/mode"),
        ("a", "/", {"a": "b", "b": "c"}, "/b"),
    ],
)
def test_names_and_remappings_are_resolved_as_in_ros_2(name, namespace, remappings, expected):
    assert topics.resolve(name, "wbc", namespace, remappings) == expected


def test_remappings_namespaces_and_topics_of_the_guard():
    assert topics.parse_remapping("odom:=/estimator/odom") == ("odom", "/estimator/odom")
    for text in ("", ":=", "a:=", ":=b", "a=b", "a:b"):
        with pytest.raises(ConfigurationError, match="from:=to"):
            topics.parse_remapping(text)
    found, made = expand(namespace="/robot", remappings={"joint_states": "/joints"})
    assert found["joint_states", ""].name == "/joints"
    others = [endpoint.name for endpoint in made if endpoint.key not in ("joint_states", "diagnostics", "clock")]
    assert all(name.startswith("/robot/") for name in others)
    written = {topic.name for topic in topics.GUARD_TOPICS if topic.direction is topics.Direction.OUT}
    assert not written & {topic.name for topic in topics.GUARD_TOPICS if topic.direction is topics.Direction.IN}


def test_the_table_expands_to_one_endpoint_for_each_task_contact_and_frame():
    found, made = expand()
    assert len(found) == len(made)
    assert len({endpoint.name for endpoint in made}) == len(made)
    assert found["setpoint", "hand"].name == "/wbc/tasks/hand/setpoint"
    assert found["setpoint", "hand"].type == "geometry_msgs/msg/PoseStamped"
    assert found["setpoint", "com"].type == "geometry_msgs/msg/PointStamped"
    assert found["trajectory", "posture"].type == "trajectory_msgs/msg/JointTrajectory"
    assert found["contact_enable", "left"].name == "/wbc/contacts/left/enable"
    assert found["contact_wrench", "right"].name == "/wbc/contacts/right/wrench"
    assert found["external_wrench", "pelvis"].name == "/wbc/external_wrenches/pelvis"
    assert found["diagnostics", ""].name == "/diagnostics"
    assert found["effort", ""].name == "/effort_controller/commands"
    assert {key for key, _ in found} == {topic.key for topic in topics.CONTROLLER_TOPICS}
    for endpoint in made:
        other = topics.counterpart(endpoint)
        assert other.direction is not endpoint.direction
        assert topics.counterpart(other) == endpoint
    found, _ = expand(settings=None, frames=())
    assert {topic.key for topic in topics.CONTROLLER_TOPICS if "{" not in topic.name} == {key for key, _ in found}


def test_types_exist():
    for topic in (*topics.CONTROLLER_TOPICS, *topics.MOCK_TOPICS):
        assert topic.type in topics.BY_TASK or topic.type in TYPES.types
        assert topic.meaning
    for columns in topics.TASK_TYPES.values():
        assert {"setpoint"} <= set(columns) <= {"setpoint", "trajectory"}
        assert set(columns.values()) <= set(TYPES.types)
    assert set(topics.TASK_TYPES) == set(types_of(TaskSettings))


def test_qualities_of_service():
    states = {"joint_states", "odom", "imu", "measured_wrench", "holds", "pose", "clock", "guard_commands"}
    for topic in topics.CONTROLLER_TOPICS:
        if topic.key in states:
            assert topic.qos == topics.Qos(reliable=False, latched=False, depth=1), topic.key
        elif topic.key in ("effort", "joint_commands", "contact_wrench"):
            assert topic.qos == topics.Qos(reliable=True, latched=False, depth=1), topic.key
        elif topic.key in ("state", "robot_description"):
            assert topic.qos == topics.Qos(reliable=True, latched=True, depth=1), topic.key
        elif topic.direction is topics.Direction.IN:  # a request
            assert topic.qos.reliable, topic.key
            assert topic.qos.depth >= 10, topic.key


@pytest.mark.parametrize(
    ("node", "alone"),
    [
        ("mock", {"push", "hold", "grip", "fault", "tf", "contact_wrench"}),
        ("guard", {"state", "diagnostics"}),
        ("estimator", {"holds", "measured_wrench", "tf", "diagnostics"}),
    ],
)
def test_mock_robot_guard_and_estimator_hear_the_controller_and_the_robot(node, alone):
    """Every row has compatible counterparts, except the topics of users and drivers."""
    made = {key: topics.endpoints(table, name, SETTINGS, namespace="/r") for key, (name, table) in topics.NODES.items()}
    lonely = set()
    for one in made[node]:
        met = [other for key in {"controller", "mock"} - {node} for other in made[key] if other.name == one.name]
        met = [other for other in met if other.direction is not one.direction]
        lonely |= set() if met else {one.key}
        for other in met:  # the reader requests no more than the writer offers
            writer, reader = (one, other) if one.direction is topics.Direction.OUT else (other, one)
            assert writer.type == reader.type
            assert writer.qos.reliable >= reader.qos.reliable
            assert writer.qos.latched >= reader.qos.latched
    assert lonely == alone


def test_there_is_no_dead_row(bench):
    """Every incoming row is subscribed and read, every outgoing row advertised and written."""
    incoming = {topic.key for topic in topics.CONTROLLER_TOPICS if topic.direction is topics.Direction.IN}
    by_hand = {  # inputs.py, takeover.py, service/
        "joint_states", "odom", "imu", "pose", "measured_wrench", "holds", "command", "robot_description", "clock",
        "record", "guard_commands",
    }  # fmt: skip
    assert incoming == set(READERS) | by_hand
    assert not set(READERS) & by_hand
    controller = bench("g1").activated(30)  # a robot that walks
    found, _ = expand(settings=controller.settings, frames=(controller.model.base_link,))
    for (key, subject), endpoint in found.items():
        if endpoint.direction is topics.Direction.OUT:
            assert controller.received(key, subject), (key, subject)
