"""Configurations for Python users: loading, changes, validation, and relative paths from the folder of their file."""

import numpy as np
import pytest
import yaml
from refusals import refusal

import wbc_controller as wbc
from wbc_controller.nodes.ros2.parameters import flatten, settings_from
from wbc_controller.settings.files import load_settings
from wbc_controller.settings.resources import locate

SMALL = {
    "robot": {"joints": ["a", "b"], "posture": [0.0, 0.1]},
    "tasks": {"com": {"type": "com"}, "posture": {"type": "posture"}},
}


def test_a_name_a_path_and_a_dictionary_are_loaded(tmp_path):
    shipped = wbc.load("g1")
    path = tmp_path / "mine.yaml"
    path.write_text(shipped.to_yaml(), encoding="utf-8")
    mine = wbc.load(path)
    assert mine.settings == shipped.settings == wbc.load(shipped.to_dict()).settings
    assert mine.source == str(path)
    assert wbc.load(mine) is mine


def test_keys_and_copies():
    dotted = wbc.load({"robot.joints": ["a", "b"], "robot.posture": np.array([0.0, 0.1]), "tasks": SMALL["tasks"]})
    assert dotted.settings == wbc.load(SMALL).settings
    old = wbc.load(SMALL)
    new = old.replace({"tasks.com.weight": 20.0, "robot.posture.b": 0.5, "tasks.posture": None})
    assert (new["tasks.com.weight"], new["robot.posture"]) == (20.0, [0.0, 0.5])
    assert list(new.settings.tasks) == ["com"]
    assert (old["tasks.com.weight"], old["robot.posture"]) == (1.0, [0.0, 0.1])
    assert list(old.settings.tasks) == ["com", "posture"]
    config = wbc.load(SMALL, urdf="<robot/>")
    assert config.replace({"tasks": {"gaze": {"type": "com"}}}).urdf == "<robot/>"
    assert config.replace({}, urdf="<other/>").urdf == "<other/>"
    assert list(config.replace({"tasks": {"gaze": {"type": "com"}}}).settings.tasks) == ["com", "posture", "gaze"]


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"tasks.com.wieght": 1.0}, "tasks.com.wieght: unknown key; did you mean 'weight'"),
        ({"tasks.com.weight": -1.0}, r"tasks\.com\.weight = -1\.0"),
        ({"tasks.com.weight": np.float64("nan")}, r"tasks\.com\.weight = nan"),
        ({"tasks.torso": None}, "tasks.torso = None: unknown entry, cannot be removed; .*Valid: com, posture"),
        ({"robot.posture.c": 0.0}, "robot.posture: 'c' is not in robot.joints; .*Valid: a, b"),
        ({"robot.posture.a": "x"}, r"robot\.posture\.0 = 'x'"),
        ({"tasks": None}, r"tasks"),
        ({"robot.joints": "a", "robot.joints.b": 1}, "conflict with parameter robot.joints.b"),
    ],
)
def test_an_error_names_the_key_and_the_valid_ones(changes, sentence):
    with pytest.raises(wbc.ConfigurationError, match=sentence):
        wbc.load(SMALL).replace(changes)


def test_an_unknown_key_names_its_neighbours_and_repr_is_a_file():
    config = wbc.load(SMALL)
    with pytest.raises(KeyError, match="tasks has no 'con'; did you mean 'com'"):
        config["tasks.con.weight"]
    assert config["control.rate"] == 500.0
    said = repr(wbc.load(SMALL))
    assert said.startswith("<Config of a dictionary>\nwbc_controller:\n  ros__parameters:\n")
    assert "posture: [0.0, 0.1]" in said


URDF = "package://example-robot-data/robots/go2_description/urdf/go2.urdf"
MODEL = "models/go2.urdf"


@pytest.fixture
def written(tmp_path, monkeypatch):
    """Write a configuration of Go2 with a URDF path, and a copy of the URDF; the working directory differs."""
    folder, elsewhere = tmp_path / "mine", tmp_path / "elsewhere"
    (folder / "models").mkdir(parents=True)
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    monkeypatch.setenv("HOME", str(folder))
    (folder / MODEL).write_text(locate(URDF).read_text(encoding="utf-8"), encoding="utf-8")

    def write(urdf, **limits):
        values = wbc.load("go2").to_dict()
        values["robot"]["urdf"] = urdf
        values |= {"limits": limits} if limits else {}
        path = folder / "go2.yaml"
        path.write_text(yaml.safe_dump({"wbc_controller": {"ros__parameters": values}}), encoding="utf-8")
        return path

    return write


def test_paths_start_at_the_folder_of_the_file(written):
    path = written(MODEL)
    assert load_settings(path).robot.urdf == str(path.parent / MODEL)
    assert wbc.check(path)[0].subject == "joints"
    path = written("~/models/go2.urdf")
    assert locate(load_settings(path).robot.urdf) == path.parent / MODEL
    path = written(MODEL, self_collision={"srdf": "models/go2.srdf"})
    assert load_settings(path).limits.self_collision.srdf == str(path.parent / "models/go2.srdf")
    path = written(MODEL)
    values = {name: value for name, value, _ in flatten(wbc.load("go2").settings)} | {"robot.urdf": MODEL}
    found, _ = settings_from(values, "/wbc", ["--params-file", str(path)])
    assert found.robot.urdf == str(path.parent / MODEL)
    named, _ = settings_from({"config": str(path)}, "/wbc", [])
    assert named.robot.urdf == str(path.parent / MODEL)
    bare, _ = settings_from(values, "/wbc", [])
    assert bare.robot.urdf == MODEL


def test_relative_path_of_a_file_with_a_relative_name(written, tmp_path, monkeypatch):
    path = written(MODEL)
    monkeypatch.chdir(path.parent)
    config = wbc.load("go2.yaml")
    monkeypatch.chdir(tmp_path)
    for same in (config, config.replace({"tasks.com.weight": 20.0})):
        assert locate(same.settings.robot.urdf) == path.parent / MODEL


@pytest.mark.parametrize("urdf", [URDF, "~/models/go2.urdf", "/no/such/place/go2.urdf", ""])
def test_other_addresses_stay_as_they_are(written, urdf):
    assert load_settings(written(urdf)).robot.urdf == urdf


def test_a_dictionary_has_no_folder_and_starts_at_the_working_directory(written, monkeypatch):
    path = written(MODEL)
    values = wbc.load("go2").to_dict()
    values["robot"]["urdf"] = MODEL
    config = wbc.load(values)
    assert config.settings.robot.urdf == MODEL
    with pytest.raises(wbc.ConfigurationError, match=r"robot.urdf = 'models/go2.urdf': file .* does not exist"):
        locate(config.settings.robot.urdf)
    monkeypatch.chdir(path.parent)
    assert locate(config.settings.robot.urdf).is_file()


def test_a_package_is_looked_for_in_ros_2_first(written, tmp_path, monkeypatch):
    folder = tmp_path / "install" / "share" / "my_description"
    folder.mkdir(parents=True)
    (folder / "robot.urdf").write_text("<robot/>", encoding="utf-8")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "install"))
    assert locate("package://my_description/robot.urdf") == folder / "robot.urdf"
    said = refusal(locate, "package://your_description/robot.urdf")
    assert "neither as a ROS 2 package on AMENT_PREFIX_PATH nor as a Python" in said
