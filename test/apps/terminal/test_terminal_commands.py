"""Commands without a node: topics by name, completion, and messages as text."""

import re

import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from command_line import wbc

from wbc_controller.apps.terminal.command_options import next_words
from wbc_controller.apps.terminal.terminal_commands import as_text, find_topic
from wbc_controller.cli import main
from wbc_controller.errors import InputRefused
from wbc_controller.middleware.codec import diagnostics, message
from wbc_controller.middleware.topics import Direction
from wbc_controller.nodes.wiring import topics_of
from wbc_controller.settings.files import find_configuration, load_settings

G1 = load_settings(find_configuration("g1"))


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("~/state", "/wbc_controller/state"),
        ("/guard/state", "/guard/state"),
        ("com/reference", "/wbc_controller/tasks/com/reference"),
        ("joint_states", "/joint_states"),
        ("mock_robot/push", "/mock_robot/push"),
    ],
)
def test_topic_by_the_end_of_its_name(text, name):
    assert find_topic(text, topics_of(G1)).name == name


def test_topics_and_messages():
    found = find_topic("~/state", topics_of(G1))
    assert (found.direction, found.qos.latched) == (Direction.OUT, True)
    with pytest.raises(InputRefused, match=re.escape("unknown topic '/wbc_controller/stat'; did you mean")):
        find_topic("/wbc_controller/stat", topics_of(G1))
    assert "did you mean 'forward'?" in wbc("send", "g1", "com", "0.02", "forwards", status=2).stderr
    text = as_text(diagnostics(1_500_000_000, 1, "wbc: loop", "active", "g1", {"mode": "active"}))
    assert text.splitlines()[:4] == ["header:", "  stamp:", "    sec: 1", "    nanosec: 500000000"]
    assert "    mode: active" in text
    assert yaml.safe_load(text)["status"][0]["name"] == "wbc: loop"
    text = as_text(message("geometry_msgs/msg/PointStamped", point=message("geometry_msgs/msg/Point", x=1 / 3)))
    assert "point: {x: 0.333333, y: 0.0, z: 0.0}" in text
    assert "position: [1.5, .nan]" in as_text(message("sensor_msgs/msg/JointState", position=np.array([1.5, np.nan])))
    assert as_text(message("std_msgs/msg/String", data="<robot>\n</robot>")) == "data: |-\n  <robot>\n  </robot>\n"


@pytest.mark.parametrize(
    ("words", "among"),
    [
        ([], {"activate", "push", "com", "left_hand"}),
        (["task"], {"com", "left_hand"}),
        (["contact", "left_foot"], {"on", "off"}),
        (["posture"], {"left_knee_joint"}),
        (["com", "0.1"], {"forward", "x"}),
        (["torso", "turn", "1"], {"left", "right"}),
        (["activate", "then"], {"release"}),
    ],
)
def test_next_word(words, among):
    assert among <= set(next_words(words, G1))


@pytest.mark.parametrize(
    ("line", "expected"),
    [("wbc send g", "go2"), ("wbc send g1 left_h", "left_hand"), ("wbc echo g1 /guard/s", "/guard/state")],
)
def test_shell_completes_robots_tasks_and_topics(line, expected):
    environment = {"_WBC_COMPLETE": "bash_complete", "COMP_WORDS": line, "COMP_CWORD": str(len(line.split()) - 1)}
    result = CliRunner().invoke(main, prog_name="wbc", env=environment)
    assert expected in [item.partition(",")[2] for item in result.output.splitlines()]
