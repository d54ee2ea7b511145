"""package.xml: well formed, consistent with pyproject.toml, setup.py and LICENSE, and complete."""

import ast
import re
from xml.etree import ElementTree

import pytest
from pages import PROJECT, ROOT

import wbc_controller
from wbc_controller.middleware.topics import NODES, TASK_TYPES

PACKAGE = ElementTree.parse(ROOT / "package.xml").getroot()  # noqa: S314  # our own file
#: Python modules of ROS 2, by the start of the module's name.
OF_ROS = ("rclpy", "launch", "launch_ros", "ament_index_python", "rcl_interfaces")


def texts(tag):
    return [element.text for element in PACKAGE.findall(tag)]


def test_form_and_agreement_with_version_setup_py_and_licence():
    assert (PACKAGE.tag, PACKAGE.get("format")) == ("package", "3")
    for tag in ("name", "version", "description", "maintainer", "license", "export"):
        assert len(texts(tag)) == 1, tag
    order = ["name", "version", "description", "maintainer", "license", "exec_depend", "test_depend", "export"]
    tags = [element.tag for element in PACKAGE]
    assert tags == sorted(tags, key=order.index)
    assert re.fullmatch(r"\d+\.\d+\.\d+", texts("version")[0])
    assert "@" in PACKAGE.find("maintainer").get("email")
    assert PACKAGE.find("export/build_type").text == "ament_python"
    for tag in ("exec_depend", "test_depend"):
        assert len(texts(tag)) == len(set(texts(tag)))
    setup = (ROOT / "setup.py").read_text(encoding="utf-8")
    (licence,) = texts("license")
    assert texts("version") == [wbc_controller.__version__]
    assert f'license="{licence}"' in setup
    assert licence == "Apache-2.0"
    assert (ROOT / "LICENSE").read_text(encoding="utf-8").split()[:4] == ["Apache", "License", "Version", "2.0,"]
    assert f'PACKAGE = "{texts("name")[0]}"' in setup


def test_packages_of_messages_imports_and_launch_files_are_dependencies():
    types = {topic.type for _, table in NODES.values() for topic in table if "/" in topic.type}
    types |= {name for kinds in TASK_TYPES.values() for name in kinds.values()}
    assert len(types) > 10
    assert {name.split("/")[0] for name in types} <= set(texts("exec_depend"))
    used = set()
    for path in [*ROOT.glob("wbc_controller/**/*.py"), *ROOT.glob("launch/*.py")]:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) and node.module and not node.level else []
            used |= {name.split(".")[0] for name in names}
    used = {name for name in used if name in OF_ROS or name.endswith(("_msgs", "_srvs"))}
    assert {"rclpy", "launch_ros", "std_srvs"} <= used
    assert used <= set(texts("exec_depend"))


#: Keys of rosdep that differ from ``python3-`` and the name of the Python package.
KEYS = {"pyyaml": "python3-yaml", "pin": "pinocchio", "proxsuite": "proxsuite"}
#: Packages without a key that installs a package of Ubuntu or ROS 2 (rosdep/python.yaml of rosdistro, 2026-08-22).
WITHOUT_KEY = {"cyclonedds", "daqp", "mcap", "osqp", "qpsolvers", "rosbags", "zstandard"}
#: Packages whose version in Ubuntu 24.04 is too old: numba 0.57, pydantic 1.10.
TOO_OLD = {"numba", "pydantic"}
REQUIREMENTS = {
    re.match(r"[\w-]+", line).group(): line
    for line in (ROOT / "requirements/ros.txt").read_text(encoding="utf-8").splitlines()
    if not line.startswith("#")
}


def test_rosdep_or_requirements_ros_txt_installs_each_dependency():
    needed = dict(re.match(r"([\w-]+)(.*)", requirement).groups() for requirement in PROJECT["dependencies"])
    assert {name for name in needed if KEYS.get(name, f"python3-{name}") not in texts("exec_depend")} == WITHOUT_KEY
    assert set(REQUIREMENTS) == WITHOUT_KEY | TOO_OLD | {"numpy"}
    for name in WITHOUT_KEY | TOO_OLD:
        assert REQUIREMENTS[name] == name + needed[name]
    assert REQUIREMENTS["numpy"].split(",")[0] == "numpy" + needed["numpy"].split(",")[0]


@pytest.mark.parametrize(
    ("tag", "requirements"),
    [("exec_depend", PROJECT["dependencies"]), ("test_depend", PROJECT["optional-dependencies"]["test"])],
)
def test_keys_of_rosdep_are_of_dependencies_in_pyproject_toml(tag, requirements):
    names = [re.match(r"[\w-]+", requirement).group() for requirement in requirements]
    keys = {KEYS.get(name, f"python3-{name}") for name in names}
    assert {key for key in texts(tag) if key.startswith("python3-") or key in KEYS.values()} <= keys
