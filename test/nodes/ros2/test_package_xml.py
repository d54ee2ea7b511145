"""package.xml: well formed, consistent with pyproject.toml, setup.py and LICENSE, and complete."""

import ast
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

import wbc_controller
from wbc_controller.middleware.topics import CONTROLLER_TOPICS, ESTIMATOR_TOPICS, GUARD_TOPICS, MOCK_TOPICS, TASK_TYPES

ROOT = Path(__file__).resolve().parents[3]
PACKAGE = ElementTree.parse(ROOT / "package.xml").getroot()  # noqa: S314  # our own file
#: What ROS 2 gives to Python, by the start of the module's name.
OF_ROS = ("rclpy", "launch", "launch_ros", "ament_index_python", "rcl_interfaces")


def texts(tag):
    return [element.text for element in PACKAGE.findall(tag)]


def test_the_form_is_that_of_format_3():
    assert (PACKAGE.tag, PACKAGE.get("format")) == ("package", "3")
    for tag in ("name", "version", "description", "maintainer", "license", "export"):
        assert len(texts(tag)) == 1, tag
    order = ["name", "version", "description", "maintainer", "license", "exec_depend", "test_depend", "export"]
    tags = [element.tag for element in PACKAGE]
    assert tags == sorted(tags, key=order.index)
    assert re.fullmatch(r"\d+\.\d+\.\d+", texts("version")[0])
    assert "@" in PACKAGE.find("maintainer").get("email")
    assert PACKAGE.find("export/build_type").text == "ament_python"


def test_it_agrees_with_version_setup_py_and_licence():
    setup = (ROOT / "setup.py").read_text(encoding="utf-8")
    (licence,) = texts("license")
    assert texts("version") == [wbc_controller.__version__]
    assert f'license="{licence}"' in setup
    assert licence == "Apache-2.0"
    assert (ROOT / "LICENSE").read_text(encoding="utf-8").split()[:4] == ["Apache", "License", "Version", "2.0,"]
    assert f'PACKAGE = "{texts("name")[0]}"' in setup


def test_no_dependency_stands_twice():
    for tag in ("exec_depend", "test_depend"):
        assert len(texts(tag)) == len(set(texts(tag)))


def test_every_package_of_a_message_is_a_dependency():
    types = {
        topic.type
        for table in (CONTROLLER_TOPICS, MOCK_TOPICS, GUARD_TOPICS, ESTIMATOR_TOPICS)
        for topic in table
        if "/" in topic.type
    }
    types |= {name for kinds in TASK_TYPES.values() for name in kinds.values()}
    assert len(types) > 10
    assert {name.split("/")[0] for name in types} <= set(texts("exec_depend"))


def test_every_package_of_ros_that_is_imported_or_launched_is_a_dependency():
    used = set()
    for path in [*ROOT.glob("wbc_controller/**/*.py"), *ROOT.glob("launch/*.py")]:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) and node.module and not node.level else []
            used |= {name.split(".")[0] for name in names}
    used = {name for name in used if name in OF_ROS or name.endswith(("_msgs", "_srvs"))}
    assert {"rclpy", "launch_ros", "std_srvs"} <= used
    assert used <= set(texts("exec_depend"))


KEYS = [name for tag in ("exec_depend", "test_depend") for name in texts(tag) if name.startswith("python3-")]


@pytest.mark.parametrize("key", KEYS)
def test_keys_of_rosdep_are_of_dependencies_in_pyproject_toml(key):
    names = {"python3-yaml": "pyyaml"}
    assert f'"{names.get(key, key.removeprefix("python3-"))}>=' in (ROOT / "pyproject.toml").read_text(encoding="utf-8")
