"""Every topic, field, joint and contact that a layout names exists, with a type that can be shown there."""

import json
import re
from xml.etree import ElementTree

import pytest
import yaml
from pages import ROOT
from services import topics_of

from wbc_controller.controller.visualization.scene import COLORS
from wbc_controller.middleware.codec import TYPES
from wbc_controller.middleware.topics import Direction
from wbc_controller.nodes.wiring import controller_endpoints
from wbc_controller.simulation.mock_robot import WORLD_FRAME

LAYOUTS = ROOT / "layouts"


@pytest.fixture(scope="module")
def published(robot_of):
    """Type and quality of service of all that the nodes of a G1 send, by topic."""
    settings, model = robot_of("g1")
    topics = [*controller_endpoints(settings, model), *topics_of("mock", settings), *topics_of("guard", settings)]
    return {topic.name: topic for topic in topics if topic.direction is Direction.OUT}


def nodes(tree, key):
    """Every value of a key, anywhere in nested mappings and lists."""
    if isinstance(tree, dict):
        for name, value in tree.items():
            if name == key:
                yield value
            yield from nodes(value, key)
    elif isinstance(tree, list):
        for value in tree:
            yield from nodes(value, key)


def has_field(type_name, path):
    """Whether a message of a type has a field such as ``wrench.force.z`` or ``effort[:]``."""
    for part in path:
        name, listed = re.fullmatch(r"(\w+)(\[:\])?", part).groups()
        fields = dict(TYPES.fielddefs[type_name][1])
        if name not in fields:
            return False
        kind, inner = fields[name]
        if bool(listed) != (kind.name in ("ARRAY", "SEQUENCE")):
            return False
        inner = inner[0] if listed else (kind, inner)
        type_name = inner[1] if inner[0].name == "NAME" else None
    return True


def test_rviz(published):
    layout = yaml.safe_load((LAYOUTS / "wbc.rviz").read_text(encoding="utf-8"))
    manager = layout["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == WORLD_FRAME
    types = {
        "rviz_default_plugins/RobotModel": "std_msgs/msg/String",
        "rviz_default_plugins/MarkerArray": "visualization_msgs/msg/MarkerArray",
        "rviz_default_plugins/Odometry": "nav_msgs/msg/Odometry",
    }
    shown = {}
    for display in manager["Displays"]:
        topic = display.get("Topic") or display.get("Description Topic")
        if topic is None:
            continue
        endpoint = published[topic["Value"]]
        shown[display["Class"]] = endpoint.type
        # A reader that asks for more than the writer offers is not connected.
        assert topic["Reliability Policy"] == "Best Effort" or endpoint.qos.reliable
        assert (topic["Durability Policy"] == "Transient Local") == endpoint.qos.latched
    assert shown == types
    (namespaces,) = nodes(manager, "Namespaces")
    assert set(namespaces) == set(COLORS)
    assert "/tf" in published


def test_foxglove(published):
    layout = json.loads((LAYOUTS / "foxglove.json").read_text(encoding="utf-8"))
    panels = layout["configById"]
    paths = [path["value"] for path in (path for paths in nodes(panels, "paths") for path in paths)]
    paths += list(nodes(panels, "topicPath"))
    assert len(paths) == 8
    for path in paths:
        topic, *fields = path.split(".")
        assert has_field(published[topic].type, fields), path
    assert set(nodes(panels, "topicToRender")) == {"/diagnostics"}
    assert set(panels["3D!robot"]["topics"]) <= published.keys()
    placed = {leaf for key in ("first", "second") for leaf in nodes(layout["layout"], key) if isinstance(leaf, str)}
    assert placed == set(panels)


def test_plotjuggler(published, robot_of):
    root = ElementTree.parse(LAYOUTS / "plotjuggler.xml").getroot()  # noqa: S314 - our own file
    _, model = robot_of("g1")
    selected = root.find(".//selected_topics").get("value").split(";")
    curves = [curve.get("name") for curve in root.iter("curve")]
    assert len(curves) == 28
    used = set()
    for curve in curves:
        topic = max((name for name in published if curve.startswith(name + "/")), key=len)
        used.add(topic)
        fields = curve.removeprefix(topic + "/").split("/")
        if published[topic].type == "sensor_msgs/msg/JointState":  # PlotJuggler sorts these by joint
            joint, *fields = fields
            assert joint in model.joints
            fields[-1] += "[:]"
        assert has_field(published[topic].type, fields), curve
    assert used == set(selected)
