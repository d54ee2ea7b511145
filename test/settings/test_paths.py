"""Relative paths in a configuration start at the folder of its file."""

import pytest
import yaml

import wbc_controller as wbc
from wbc_controller.errors import ConfigurationError
from wbc_controller.nodes.ros2.parameters import flatten, settings_from
from wbc_controller.settings.files import load_settings
from wbc_controller.settings.resources import locate

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
    with pytest.raises(ConfigurationError, match=r"robot.urdf = 'models/go2.urdf': file .* does not exist"):
        locate(config.settings.robot.urdf)
    monkeypatch.chdir(path.parent)
    assert locate(config.settings.robot.urdf).is_file()


def test_a_package_is_looked_for_in_ros_2_first(written, tmp_path, monkeypatch):
    folder = tmp_path / "install" / "share" / "my_description"
    folder.mkdir(parents=True)
    (folder / "robot.urdf").write_text("<robot/>", encoding="utf-8")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "install"))
    assert locate("package://my_description/robot.urdf") == folder / "robot.urdf"
    with pytest.raises(ConfigurationError, match="neither as a ROS 2 package on AMENT_PREFIX_PATH nor as a Python"):
        locate("package://your_description/robot.urdf")
