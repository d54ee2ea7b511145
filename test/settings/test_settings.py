"""Configuration files: defaults, ranges, error messages."""

import faulthandler
from functools import partial
from pathlib import Path

import pytest
import yaml
from command_line import wbc
from refusals import refusal

from wbc_controller.errors import ConfigurationError
from wbc_controller.settings import Settings
from wbc_controller.settings.files import find_configuration, load_settings, parse_settings, read_yaml
from wbc_controller.settings.resources import locate, read_text

FOLDER = Path(__file__).parent / "configurations"

MINIMAL = {"robot": {"joints": ["a"], "posture": [0.0]}, "tasks": {"posture": {"type": "posture"}}}

#: Required parts of the error of each broken file.
BROKEN = {
    "unknown_joint": ("robot.joints: 'RR_claf_joint'", "did you mean 'RR_calf_joint'?", "FL_hip_joint"),
    "unknown_frame": ("contacts.rear_left_foot.frame = 'RL_fot'", "did you mean 'RL_foot'?", "FL_foot"),
    "unknown_solver": ("solver.name = 'dapq'", "did you mean 'daqp'?", "osqp"),
    "missing_urdf": ("robot.urdf = 'package://example-robot-data/", "go3.urdf does not exist"),
    "malformed": (":9: not valid YAML", "expected ',' or ']'"),
    "duplicate_key": (":18: tasks.com: duplicate key 'com'", "first in line 16"),
    "duplicate_joint": ("robot.joints: duplicate 'RL_calf_joint'",),
    "posture_too_short": ("robot.posture has 11 values for 12 joints",),
    "infeasible_stance": ("robot.posture on front_left_foot, front_right_foot", "179 mm outside the support"),
}


def test_every_broken_file_has_its_expectation():
    assert {path.stem for path in FOLDER.glob("*.yaml")} == set(BROKEN)


@pytest.mark.parametrize("name", BROKEN)
def test_check_refuses_a_broken_file_with_one_readable_error(name):
    path = FOLDER / f"{name}.yaml"
    result = wbc("check", path, status=2)
    assert isinstance(result.exception, SystemExit)  # no other exception
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith(f"error: {path}:")
    for part in BROKEN[name]:
        assert part in lines[0]
    assert result.stdout == ""


def test_a_file_that_does_not_exist_is_no_text_or_too_long_is_refused(tmp_path):
    path = str(tmp_path / "g2.yaml")
    result = wbc("check", path, status=2)
    assert repr(path) in result.stderr
    assert "did you mean 'go2'? Valid: g1, go2, talos" in result.stderr
    path = tmp_path / "robot.srdf"
    path.write_bytes(b"<robot>\xff</robot>")
    limited = partial(read_text, path, "limits.x = 'y'")
    assert refusal(limited, 100).startswith("limits.x = 'y': cannot be read: 'utf-8' codec")
    path.write_text("x" * 101)
    assert refusal(limited, 100).startswith("limits.x = 'y': longer than 100 characters")
    assert limited(101) == "x" * 101


@pytest.mark.parametrize("command", ["run", "mock"])
def test_node_names_the_invalid_file(command, monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", "77")
    path = FOLDER / "unknown_joint.yaml"
    assert wbc(command, path, status=2).stderr.startswith(f"error: {path}: robot.joints: 'RR_claf_joint'")


def _with(key, value):
    content = {
        "robot": {"joints": ["a"], "posture": [0.0]},
        "tasks": {
            "posture": {"type": "posture"},
            "com": {"type": "com"},
            "hand": {"type": "frame_pose", "frame": "hand"},
            "spin": {"type": "angular_momentum"},
            "steady": {"type": "capture_point"},
        },
        "contacts": {
            "foot": {"type": "surface", "frame": "f", "half_length": 0.1, "half_width": 0.1, "max_normal_force": 1.0},
            "toe": {"type": "point", "frame": "f", "max_normal_force": 1.0},
            "grip": {"type": "fixed", "frame": "f", "max_force": 1.0, "max_moment": 1.0},
            "wheel": {"type": "rolling", "frame": "f", "axis": [0, 1, 0], "radius": 0.1, "max_normal_force": 1.0},
        },
        "loops": {"bar": {"frame_a": "f", "frame_b": "g"}},
    }
    place = content
    *sections, last = key.split(".")
    for section in sections:
        place = place.setdefault(section, {})
    place[last] = value
    return content


CURVE, BLOCK = "limits.torque_speed.actuators.a", "mock.terrain.step"
FORCES = {"contact_force_on": 0.1, "contact_force_off": 0.2}
FLAT = {"position": [-1.0, 0.0, 0.3], "size": [3.0, 3.0, 0.2]}


@pytest.mark.parametrize(
    ("key", "low", "high"),
    [
        ("control.rate", 10.0, 10000.0),
        ("robot.armature", 0.0, 10.0),
        ("limits.velocity_scale", 1e-9, 1.0),
        ("solver.regularization_acceleration", 1e-12, 1.0),
        ("tasks.hand.stiffness", 0.0, 1e5),
        ("contacts.foot.friction", 1e-9, 2.0),
        ("contacts.toe.radius", 1e-9, 1.0),
        ("contacts.grip.max_force", 1e-9, 1e5),
        ("loops.bar.stiffness", 0.0, 1e5),
        ("mock.step", 1e-9, 0.01),
    ],
)
def test_ranges(key, low, high):
    for good in (low, high):
        parse_settings(_with(key, good), "file.yaml")
    for bad in (low - 1e-6, 1.001 * high, float("nan"), float("inf"), -float("inf"), "much", None, [1.0]):
        said = refusal(parse_settings, _with(key, bad), "file.yaml")
        assert said.startswith(f"file.yaml: {key} = {bad!r}: ")
        assert len(said.splitlines()) == 1


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("robot.base", "flying", "robot.base = 'flying': input should be 'floating' or 'fixed'"),
        ("contrl", {}, "contrl: unknown key; did you mean 'control'?"),
        ("walking", {"clearence": 0.1}, "walking.clearence: unknown key; did you mean 'clearance'? Valid: clearance"),
        ("contacts.toe.half_length", 0.1, "contacts.toe.half_length: unknown key; Valid: against, damping"),
        ("tasks.com.mask", [True], "tasks.com.mask = [True]: list should have at least 3 items"),
        ("contacts.foot.vertices", [[0, 0], [0.1, 0], [0, 0.1]], "contacts.foot.half_length = 0.1: a surface requires"),
        ("contacts.foot.half_width", None, "contacts.foot.half_width = None: a surface requires either half_l"),
        ("contacts.toe.normal", [0, 0, 0], "contacts.toe.normal = [0, 0, 0]: must not be zero (Outward normal of th"),
        ("contacts.grip.mask", [False] * 6, "contacts.grip.mask = [False, False, False, False, False, False]: requ"),
        ("contacts.grip.max_moment", None, "contacts.grip.max_moment = None: required, as the mask contains a rot"),
        ("contacts.wheel.axis", [0, 0, 0], "contacts.wheel.axis = [0, 0, 0]: must not be zero (Direction"),
        ("loops.bar.stifness", 1.0, "loops.bar.stifness: unknown key; did you mean 'stiffness'?"),
        ("loops.bar.mask", [False] * 6, "loops.bar.mask = [False, False, False, False, False, False]: requires at le"),
        ("loops.foot", {"frame_a": "f", "frame_b": "g"}, "loops: 'foot' is also the name of a contact; use differ"),
        ("mock.floor_normal", [0, 0, 0], "mock.floor_normal = [0, 0, 0]: must not be zero (Normal of the floor"),
        ("contacts.foot.type", "sufrace", "contacts.foot.type: unknown type 'sufrace'; did you mean 'surface'?"),
        ("contacts.foot.type", None, "contacts.foot.type: missing key; Valid: fixed, point, rolling, surface"),
        ("tasks.com.stiffness", [1.0, 2.0], "tasks.com.stiffness = [1.0, 2.0]: 2 values; expected one number, or"),
        ("tasks.spin.stiffness", 1.0, "tasks.spin.stiffness: unknown key; Valid: damping, enabled, level, mask"),
        ("tasks.steady.gain", [1.0] * 3, "tasks.steady.gain = [1.0, 1.0, 1.0]: 3 values; expected one number, or"),
        ("tasks.hand.damping", [1.0] * 5 + [-1.0], "tasks.hand.damping.5 = -1.0: input should be greater than or"),
        ("tasks.com.stiffness", [1.0, "x", 1.0], "tasks.com.stiffness.1 = 'x': input should be a valid number"),
        ("robot.posture", [float("nan")], "robot.posture.0 = nan: input should be a finite number (Nominal"),
        ("robot.joint_limits", {"a": {"lower": 1.0, "upper": -1.0}}, "robot.joint_limits.a.lower = 1.0: must be below"),
        ("contacts.foot.half_length", 10.0, "contacts.foot.half_length = 10.0: input should be less than or equal to"),
        ("limits.torque_speed.corner", 1.2, "limits.torque_speed.no_load = 1.0: must be above corner = 1.2"),
        (CURVE, {"corner": 3.0, "no_load": 2.0}, f"{CURVE}.no_load = 2.0: must be above corner = 3.0"),
        (f"{CURVE}.corner", 3.0, f"{CURVE}.no_load: missing key (Speed of zero torque"),
        ("control.realtime.scheduling", "deadline", "control.realtime.scheduling = 'deadline': input should be 'ot"),
        ("control.realtime.priority", 0, "control.realtime.priority = 0: input should be greater than or equal to 1"),
        ("control.realtime.priority", 100, "control.realtime.priority = 100: input should be less than or equal to 99"),
        ("control.realtime.affinity", [-1], "control.realtime.affinity.0 = -1: input should be greater than or equal"),
        ("control.realtime.lock_memory", 7, "control.realtime.lock_memory = 7: input should be a valid boolean"),
        ("control.realtime.cpu_dma_latency", -1, "control.realtime.cpu_dma_latency = -1: input should be greater than"),
        ("estimation", FORCES, "estimation.contact_force_off = 0.2: must not exceed contact_force_on = 0.1"),
        ("limits.self_collision.marjin", 0.1, "limits.self_collision.marjin: unknown key; did you mean 'margin'?"),
        (BLOCK, {"size": [1, 1, 1]}, f"{BLOCK}.position: missing key (Middle of the upper edge at -x"),
        (BLOCK, FLAT | {"size": [1, 1, 0]}, f"{BLOCK}.size.2 = 0: input should be greater than 0 (Along x"),
        (BLOCK, FLAT | {"unevenness": 0.02, "cell": 0.01}, f"{BLOCK}.cell = 0.01: the block has 90000 cells; at most"),
    ],
)
def test_errors_name_key_value_and_valid_values(key, value, said):
    assert refusal(parse_settings, _with(key, value), "file.yaml").startswith(f"file.yaml: {said}")


@pytest.mark.parametrize(("task", "size"), [("com", 3), ("hand", 6), ("posture", 2)])
def test_gains_are_one_number_or_one_for_each_axis(task, size):
    for key in ("stiffness", "damping"):
        for good in (7.0, [7.0] * size):
            settings = parse_settings(_with(f"tasks.{task}.{key}", good), "f")
            assert getattr(settings.tasks[task], key) == good


def test_all_errors_of_a_file_are_reported_in_a_line_each():
    content = _with("control.rate", 0.0)
    content["tasks"]["com"]["weight"] = -1.0
    assert len(refusal(parse_settings, content, "f").splitlines()) == 2
    said = refusal(parse_settings, MINIMAL | {"con\ntrol": {}}, "file.yaml")
    assert said.startswith(r"file.yaml: 'con\ntrol': unknown key")
    assert len(said.splitlines()) == 1


@pytest.mark.parametrize("node", ["wbc_controller", "/**"])
def test_the_parameters_stand_below_the_node_or_all_nodes(tmp_path, node):
    path = tmp_path / "file.yaml"
    path.write_text(yaml.safe_dump({node: {"ros__parameters": MINIMAL}}))
    assert load_settings(path).robot.joints == ["a"]


def test_settings_are_described_and_cannot_be_changed():
    with pytest.raises(ValueError, match="frozen"):
        parse_settings(MINIMAL, "x").control.rate = 1.0
    for section, schema in Settings.model_json_schema()["$defs"].items():
        undescribed = {name for name, key in schema["properties"].items() if "description" not in key}
        assert undescribed <= {"type"}, section


BOMB = "a0: &a0 {b: 1}\n" + "".join(f"a{i}: &a{i} {{x: *a{i - 1}, y: *a{i - 1}}}\n" for i in range(1, 30))
MERGES = "a0: &a0 {b: 1}\n" + "".join(f"a{i}: &a{i} {{<<: [*a{i - 1}, *a{i - 1}]}}\n" for i in range(1, 30))
TASKS = "wbc_controller: {ros__parameters: {robot: {joints: [a], posture: [0.0]}, tasks: {posture: {type: posture}}"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "contains NoneType, expected a mapping"),
        ("wbc: {}", "missing key 'wbc_controller' (found: 'wbc')"),
        ("wbc_controller: {robot: {}}", "missing mapping 'ros__parameters'"),
        ("wbc_controller: {ros__parameters: {tasks: {posture: {type: posture}}}}", "robot: missing key"),
        ("wbc_controller: {ros__parameters: {tasks: {posture: {type: posture}}, robot: }}", "robot = None"),
        (b"\xff\xfe\x00", "cannot be read"),
        ("a: \x00", "not valid YAML"),
        ("a: 2001-99-99", "not valid YAML: month must be in 1..12"),
        ("a: &a {b: *a}", "not valid YAML"),
        ("a: {b: &b {c: 1, c: 2}}", "duplicate key 'c'"),
        (BOMB, "more than 20000 values with aliases expanded"),
        (MERGES, "more than 20000 values"),
        ("a: [" + ", ".join(["1"] * 20000) + "]", "more than 20000 values"),
        ("a: &a [*a]", ":1: not valid YAML: recursive alias"),
        (f"{TASKS}, control: {{rate: 0x{'f' * 5000}}}}}}}", "control.rate: integer with 5002 characters; at most"),
        (f"{TASKS}, solver: {{name: {'x' * 5000}}}}}}}", "solver.name: value with 5000 characters; at most 4096"),
        ("a: " + "[" * 5000, "not valid YAML: maximum recursion depth exceeded"),
        (" " * 2_000_000, "longer than 1000000 characters"),
        ("a: [{b: 1, b: 2}]", ":1: a.b: duplicate key 'b'"),
    ],
    ids=["empty", "node", "parameters", "no robot", "robot", "binary", "zero", "date", "mapping in itself", "twice",
         "aliases", "merges", "values", "list in itself", "number", "string", "deep", "long", "twice in a list"],
)  # fmt: skip
def test_a_file_of_another_form_or_size_is_refused_before_construction_in_one_sentence(tmp_path, text, said):
    path = tmp_path / "file.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    faulthandler.dump_traceback_later(120.0, exit=True)  # an endless read ends the tests
    try:
        result = wbc("check", path, status=2)
    finally:
        faulthandler.cancel_dump_traceback_later()
    assert result.stderr.startswith(f"error: {path}:")
    assert said in result.stderr
    assert len(result.stderr.removesuffix("\n  wbc_controller:\n    ros__parameters:\n").splitlines()) == 1
    assert len(result.stderr) < 1000


def test_the_fast_loader_reads_and_refuses_the_same():
    fast = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    assert read_yaml("{a: &a [1, 2.5, x], b: *a}", "update", fast) == {"a": [1, 2.5, "x"], "b": [1, 2.5, "x"]}
    assert read_yaml("", "update", fast) is None
    for text in (BOMB, "a: &a [*a]", "{a: 1, a: 2}", f"a: 0x{'f' * 3700}", "{a: [", "a: 2026-99-99"):
        for loader in (fast, yaml.SafeLoader):
            assert refusal(read_yaml, text, "update", loader).startswith("update:")


@pytest.mark.parametrize(
    ("urdf", "said"),
    [
        ("x" * 5000, ": file xxx"),
        ("package://" + "x" * 5000 + "/y.urdf", "package 'xxx"),
        ("package://example-robot-data/" + "x" * 5000, ": file /"),
        ("~nosuchuser/x.urdf", "robot.urdf = '~nosuchuser/x.urdf': could not determine home directory"),
        ("nul\0l.urdf", "does not exist"),
        ("/nowhere/robot.urdf", "'/nowhere/robot.urdf': file /nowhere/robot.urdf does not exist"),
        ("package://none/a.urdf", "on AMENT_PREFIX_PATH nor as a Python distribution; example-robot-data: pip install"),
        ("package://example-robot-data/robots/none.urdf", "none.urdf does not exist"),
        ("package://numpy/robot.urdf", "'numpy' has no folder share/numpy"),
    ],
    ids=["long", "long package", "long in a package", "user", "zero", "file", "package", "in a package", "no share"],
)
def test_a_path_without_a_file_is_refused_in_words(urdf, said, monkeypatch):
    monkeypatch.setenv("AMENT_PREFIX_PATH", "/nowhere")
    refused = refusal(locate, urdf)
    assert said.lower() in refused.lower()
    assert len(refused) < 1200


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("tallos", r"'tallos'; did you mean 'talos'\? Valid: g1, go2, talos"),
        *((name, r"\(5\d\d\d characters\)") for name in ("x" * 5000, "x" * 5000 + ".yaml", "a/" + "x" * 5000)),
    ],
)
def test_a_configuration_name_without_a_file_is_refused_in_words(name, said):
    with pytest.raises(ConfigurationError, match=said):
        find_configuration(name)


@pytest.mark.parametrize("section", ["tasks", "contacts", "loops"])
@pytest.mark.parametrize("name", ["left\nfoot", "left foot", "a/b", "", "2nd", "füße", "a.b", "~", "{x}", "x" * 101])
def test_a_name_that_no_topic_can_hold_is_refused(section, name):
    content = _with("control.rate", 500.0)
    content[section] = {name: next(iter(content[section].values()))}
    refused = refusal(parse_settings, content, "file.yaml")
    shown = repr(name) if len(name) <= 100 else "of 101 characters"
    assert refused.startswith(f"file.yaml: {section}: ")
    assert f"name {shown} is not valid in a ROS topic: use letters, digits and underscores" in refused
    assert len(refused.splitlines()) == 1
