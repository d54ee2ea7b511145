"""Requests of `wbc send`: each becomes one message on one topic."""

import re

import numpy as np
import pytest

from wbc_controller.apps.terminal.request_parser import parse_request
from wbc_controller.errors import InputRefused
from wbc_controller.settings.files import find_configuration, load_settings

G1 = load_settings(find_configuration("g1"))
HALF = np.sqrt(0.5)


def read(text, settings=G1):
    return parse_request(text.split(), settings)


def no_message(*place):
    raise AssertionError(f"the message needs nothing of {place}")


def made(text, wait_for_message=no_message):
    return read(text).make(wait_for_message)


@pytest.mark.parametrize(
    ("text", "node", "key", "subject", "data"),
    [
        ("activate", "controller", "command", "", "activate"),
        ("release", "mock", "hold", "", False),
        ("contact left_foot off", "controller", "contact_enable", "left_foot", False),
        ("grip left_foot on", "mock", "grip", "left_foot", True),
        ("weight com 30", "controller", "weight", "com", 30.0),
        ("update {tasks: {com: {weight: 5}}}", "controller", "update", "", "{tasks: {com: {weight: 5}}}"),
        ("record", "controller", "record", "", ""),
        ("record a fine step", "controller", "record", "", "a-fine-step"),
        ("fault clear", "mock", "fault", "", "clear"),
    ],
)
def test_words_and_switches(text, node, key, subject, data):
    request = read(text)
    assert (request.node, request.key, request.subject) == (node, key, subject)
    assert request.make(no_message).data == data


@pytest.mark.parametrize(
    ("text", "frame", "step"),
    [
        ("com +0.02 forward", "com/heading", (0.02, 0.0, 0.0)),
        ("com 0.02 back 10mm left", "com/heading", (-0.02, 0.01, 0.0)),
        ("com 2cm right 0.01 down", "com/heading", (0.0, -0.02, -0.01)),
        ("com -0.02 x 0.01 up", "com/reference", (-0.02, 0.0, 0.01)),
    ],
)
def test_relative_setpoint_of_a_task(text, frame, step):
    request, content = read(text), made(text)
    assert (request.key, request.subject, content.header.frame_id) == ("setpoint", "com", frame)
    np.testing.assert_allclose([content.point.x, content.point.y, content.point.z], step, atol=1e-12)


def test_setpoints_of_poses_and_in_frames():
    content = made("left_hand 0.1 up")
    assert content.header.frame_id == "left_hand/heading"
    assert (content.pose.position.z, content.pose.orientation.w) == (0.1, 1.0)
    content = made("com to 0.01 -0.02 0.6")
    assert (content.header.frame_id, content.point.y, content.point.z) == ("world", -0.02, 0.6)
    assert made("com to 0 0 0 in pelvis").header.frame_id == "pelvis"
    known = {("controller", "task_reference", "left_hand"): made("left_hand to 0 0 0 0 0 0.7071 0.7071")}
    content = made("left_hand to 0.3 0.2 0.9", lambda *place: known[place])
    assert (content.pose.position.x, content.pose.orientation.z) == (0.3, 0.7071)


TURNS = [("turn 90deg left", (0, 0, 1)), ("turn 90deg right", (0, 0, -1)), ("lean 90deg forward", (0, 1, 0))]


@pytest.mark.parametrize(("text", "axis"), TURNS)
def test_turning_and_leaning(text, axis):
    turned = made(f"torso {text}").pose.orientation
    np.testing.assert_allclose([turned.x, turned.y, turned.z, turned.w], [*(HALF * np.array(axis)), HALF], atol=1e-12)


def test_joints_by_and_to(make):
    step = made("posture left_knee_joint by 0.1 right_knee_joint by -10deg")
    assert (step.header.frame_id, step.name) == ("posture/reference", ["left_knee_joint", "right_knee_joint"])
    np.testing.assert_allclose(step.position, [0.1, -np.pi / 18.0])
    before = make.joint_state(["a", "b"], [1.0, 2.0])
    content = made("posture b to 0.6", lambda *place: before)
    assert (content.header.frame_id, content.name) == ("", ["a", "b"])
    np.testing.assert_array_equal(content.position, [1.0, 0.6])
    with pytest.raises(InputRefused, match="unknown joint 'c'"):
        made("posture c to 0.6", lambda *place: before)


def test_push_has_heading_axes(make):
    request = read("push 60 forward for 0.1 at torso")
    assert (request.node, request.key, request.frame) == ("mock", "push", "torso_link")
    odometry = make.odom([0, 0, 1, 0, 0, HALF, HALF], child="pelvis")
    force = request.make(lambda *place: {("mock", "odom", ""): odometry}[place]).wrench.force
    np.testing.assert_allclose([force.x, force.y, force.z], [0.0, 60.0, 0.0], atol=1e-9)
    assert made("push 5N up 3 x").wrench.force.z == 5.0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("actvate", "unknown command 'actvate'; did you mean 'activate'? Valid: "),
        ("activate now", "'activate' takes no arguments, got 'now'"),
        ("contact left_fot off", "did you mean 'left_foot'?"),
        ("contact left_foot of", "unknown value 'of'; did you mean 'off'? Valid: off, on"),
        ("task left_hand", "task requires TASK on|off; got 'left_hand'"),
        ("weight com heavy", "weight: expected a number, got 'heavy'"),
        ("com 0.02", "com requires pairs of a number and a direction, such as 0.02 forward; got '0.02'"),
        ("com 0.02 forwards", "com: unknown direction 'forwards'; did you mean 'forward'?"),
        ("com 2in forward", "com: unknown unit in '2in'; Valid: "),
        ("com 0.02 forward 0.01 x", "mixes directions of the robot with axes x, y, z of the world"),
        ("torso 0.02 forward", "torso is a frame_orientation task; valid forms: turn 10deg left"),
        ("torso turn 10deg up", "torso turn: unknown direction 'up'; Valid: left, right"),
        ("posture left_knee_joint 0.1", "posture requires JOINT by NUMBER or JOINT to NUMBER"),
        ("push 60 forward for 0.3", "180 N for 0.1 s give the same impulse"),
        ("update", "update requires YAML"),
    ],
)
def test_refusals(text, said):
    with pytest.raises(InputRefused, match=re.escape(said)):
        made(text)
