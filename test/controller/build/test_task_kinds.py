"""Each kind of task from YAML to torques, with the snippets of docs/tasks.md and all topics."""

import re

import numpy as np
import pytest
import yaml
from pages import page, snippets

from wbc_controller.controller.build.tasks import make_task
from wbc_controller.inverse_dynamics.robot.dynamics import Dynamics
from wbc_controller.middleware.topics import TASK_TYPES
from wbc_controller.settings.files import types_of
from wbc_controller.settings.tasks import TaskSettings

TASKS = types_of(TaskSettings)

PAGE = page("tasks")
#: Tasks of the page, and its updates by task.
SHOWN = {name: task for block in snippets(PAGE) for name, task in block.items()}
TEXTS = re.findall(r"`(\{tasks: \{.*?\}\}\})`", PAGE)
UPDATES = {name: text for text in TEXTS for name in yaml.safe_load(text)["tasks"]}
#: Tasks in one snippet.
TOGETHER = {"inside", "reach", "rest"}


def test_the_page_has_a_section_and_an_example_for_each_kind():
    headings = " ".join(re.findall(r"^## (.*)$", PAGE, re.MULTILINE))
    for kind in TASKS:
        assert f"`{kind}`" in headings
    shown = {task["type"] for task in SHOWN.values()}
    assert set(TASKS) - shown == {"linear_momentum"}  # in the snippet of the angular momentum
    assert set(SHOWN) - set(UPDATES) == {"com", "height", "rest"}  # snippets of gains only
    assert set(TASK_TYPES) == set(TASKS)


@pytest.mark.parametrize("name", SHOWN)
def test_snippets_of_the_page(bench, make, name):
    shown = {name: SHOWN[name]} if name not in TOGETHER else {other: SHOWN[other] for other in TOGETHER}
    robot = bench("g1", {"tasks": shown})
    assert robot.activate().solution is not None
    if name in UPDATES:
        robot.send("update", make.string(UPDATES[name]))
    report = robot.cycle(20)
    assert not any(report.refused for report in robot.reports)
    assert name in report.solution.task_errors
    assert not report.solution.relaxed


#: Configuration, setpoint, trajectory of two points, and frame of each kind.
HALF = float(np.sqrt(0.5))
COMMANDED = {
    "relative_pose": (
        {"frame": "left_rubber_hand", "reference_frame": "right_rubber_hand"},
        ("pose", ([0.0, 0.4, 0.0], [0.0, 0.0, 0.0, 1.0], "right_rubber_hand")),
        [0.0, 0.4, 0.02, 0.0, 0.0, 0.0, 1.0], "right_rubber_hand",
    ),
    "axis_alignment": ({"frame": "left_rubber_hand", "axis": [1, 0, 0]}, ("vector", ([0.0, 0.0, -2.0],)),
        [HALF, 0.0, -HALF, 0, 0, 0, 1], "world"),
    "gaze": ({"frame": "torso_link", "axis": [1, 0, 0]}, ("point", ([1, 0.1, 1],)), [1, 0.2, 1, 0, 0, 0, 1], "world"),
    "linear_momentum": ({}, ("vector", ([0.0, 0.5, 0.0],)), [0.0, 0.2, 0.0, 0, 0, 0, 1], "world"),
    "angular_momentum": ({}, ("vector", ([0.0, 0.0, 0.1],)), [0.0, 0.0, 0.2, 0, 0, 0, 1], "world"),
    "capture_point": ({}, ("point", ([0.01, 0.01, 7.0],)), [0.0, 0.01, 0.0, 0, 0, 0, 1], "world"),
}  # fmt: skip


@pytest.mark.parametrize("kind", COMMANDED)
def test_a_setpoint_and_a_trajectory_by_topic_move_the_reference_there(bench, make, kind):
    keys, (message, values), knot, frame = COMMANDED[kind]
    robot = bench("g1", {"tasks": {"task": {"type": kind, "weight": 0.01, "setpoint_duration": 0.05} | keys}})
    robot.activate()
    board = robot.loop.controller.board
    size = len(board.sample(robot.clock.time).tasks["task"].position)
    robot.send("setpoint", getattr(make, message)(*values), "task")
    robot.cycle(30)
    goal = np.concatenate([np.ravel(value) for value in values if not isinstance(value, str)])[:size]
    if kind == "axis_alignment":
        goal = goal / np.linalg.norm(goal)
    np.testing.assert_allclose(board.sample(robot.clock.time).tasks["task"].position, goal, atol=1e-9)
    robot.send("trajectory", make.frame_trajectory([(0.05, [knot])], frame), "task")
    report = robot.cycle(30)
    np.testing.assert_allclose(board.sample(robot.clock.time).tasks["task"].position, knot[:size], atol=1e-9)
    assert not any(report.refused for report in robot.reports)
    assert np.isfinite(report.solution.task_errors["task"])


@pytest.mark.parametrize("kind", ["contact_wrench", "torque"])
def test_effort_setpoint_by_topic(bench, make, kind):
    if kind == "torque":
        keys, goal = {"joints": ["left_elbow_joint"]}, [1.5]
        setpoint = make.joint_state(["left_elbow_joint"], (), effort=goal)
    else:
        keys, goal = {"contact": "left_foot", "mask": [i == 2 for i in range(6)]}, [0, 0, 120.0, 0, 0, 0]
        setpoint = make.wrench(goal, "left_ankle_roll_link")
    robot = bench("g1", {"tasks": {"task": {"type": kind, "weight": 100.0, "setpoint_duration": 0.1} | keys}})
    robot.activate()
    robot.send("setpoint", setpoint, "task")
    report = robot.cycle(100)
    assert not any(report.refused for report in robot.reports)
    solution = report.solution
    joint = robot.model.joints.index("left_elbow_joint")
    reached = solution.tau[joint] if kind == "torque" else solution.forces["left_foot"][2]
    assert reached == pytest.approx(max(goal), rel=0.02)
    assert solution.task_errors["task"] == pytest.approx(abs(reached - max(goal)), abs=1e-6)
    assert not any(endpoint.key == "trajectory" and endpoint.subject == "task" for endpoint in robot.topics)


@pytest.mark.parametrize("kind", COMMANDED)
def test_every_setting_reaches_the_task(robot_of, kind):
    _, model = robot_of("g1")
    size = {"relative_pose": 6, "axis_alignment": 2, "gaze": 2, "capture_point": 2}.get(kind, 3)
    given = dict(COMMANDED[kind][0])
    rising = [float(i) for i in range(1, size + 1)]
    masked = "mask" in TASKS[kind].model_fields
    gains = [key for key in ("stiffness", "damping", "gain") if key in TASKS[kind].model_fields]
    given |= {key: [(i + 1) * value for value in rising] for i, key in enumerate(gains)}
    given |= {"mask": [False] + [True] * (size - 1)} if masked else {}
    given |= {"support_height": -0.5} if kind == "capture_point" else {}
    task = make_task("task", TASKS[kind].model_validate({"type": kind} | given), model, {})
    assert task.dimension == size - masked
    for i, key in enumerate(gains):
        value = getattr(task, key) if hasattr(task, key) else task.gain
        np.testing.assert_array_equal(value, (i + 1) * np.array(rising))
    for key in ("frame", "reference_frame", "support_height"):
        if key in given:
            assert getattr(task, key) == given[key]
    if "axis" in given:
        dynamics = Dynamics(model)
        frame = dynamics.placement(model.pinocchio.getFrameId(given["frame"]))
        np.testing.assert_allclose(task.direction(dynamics), frame.rotation @ given["axis"])
