"""Configurations for Python users: loading, changes, validation."""

import numpy as np
import pytest

import wbc_controller as wbc

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
