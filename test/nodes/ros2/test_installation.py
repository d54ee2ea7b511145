"""Refusal of two ROS 2 in one process: the wheels of PyPI, and a sourced installation."""

import os
import subprocess
import sys
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from types import SimpleNamespace

import pytest
from refusals import refusal

from wbc_controller.nodes.ros2 import installation
from wbc_controller.nodes.ros2.installation import refuse_mixed_installations


@pytest.fixture
def environment(tmp_path, monkeypatch):
    """Make a virtual environment with the wheels and without a sourced ROS 2; return the folder of its packages."""
    prefix = tmp_path / "venv"
    site = prefix / "lib/python3.12/site-packages"
    _make(prefix / "lib/librcl.so")
    _make(site / "rclpy/__init__.py")
    monkeypatch.setattr(sys, "prefix", str(prefix))
    monkeypatch.syspath_prepend(str(site))
    monkeypatch.setattr(installation, "distribution", lambda name: SimpleNamespace(locate_file=lambda path: site))
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    monkeypatch.setenv("LD_LIBRARY_PATH", str(prefix / "lib"))  # as the wheels set it
    # An earlier test may have imported the real module, which find_spec would return.
    monkeypatch.delitem(sys.modules, "rclpy", raising=False)
    return site


def _make(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()


def test_the_wheels_are_accepted_alone_and_with_a_workspace_and_their_prefix(environment, tmp_path, monkeypatch):
    refuse_mixed_installations()
    workspace = tmp_path / "ws/install/my_package"
    _make(workspace / "share/ament_index/resource_index/packages/my_package")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{workspace}:{sys.prefix}")
    refuse_mixed_installations()


@pytest.mark.parametrize(("variable", "folder"), [("AMENT_PREFIX_PATH", ""), ("LD_LIBRARY_PATH", "lib")])
def test_a_sourced_installation_is_refused_with_both_paths(environment, tmp_path, monkeypatch, variable, folder):
    sourced = tmp_path / "opt/ros/jazzy"
    _make(sourced / "lib/librcl.so")
    monkeypatch.setenv(variable, f"{tmp_path / 'ws'}:{sourced / folder}")
    sentence = refusal(refuse_mixed_installations)
    assert sentence.startswith("two installations of ROS 2: wheels")
    assert f"in {environment}, " in sentence
    assert f" in {sourced}. " in sentence
    assert "a shell without a sourced ROS 2" in sentence


def test_rclpy_from_another_place_than_the_wheels_is_refused(environment, tmp_path, monkeypatch):
    sourced = tmp_path / "opt/ros/jazzy/lib/python3.12/site-packages"
    _make(sourced / "rclpy/__init__.py")
    monkeypatch.syspath_prepend(str(sourced))  # as PYTHONPATH does
    assert f" in {sourced}. " in refusal(refuse_mixed_installations)


def test_a_sourced_installation_alone_is_accepted(environment, tmp_path, monkeypatch):
    def missing(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr(installation, "distribution", missing)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "venv"))
    refuse_mixed_installations()


#: Fails if a module of ROS 2 is imported.
REFUSED = """
import sys
class Finder:
    def find_spec(self, name, *rest):
        assert name != "wbc_controller.nodes.ros2.process", "rclpy is about to be imported"
sys.meta_path.insert(0, Finder())
from wbc_controller.nodes.ros2 import installation
from wbc_controller.errors import ConfigurationError
def refuse(): raise ConfigurationError("two installations of ROS 2")
import wbc_controller.node as node
node.refuse_mixed_installations = refuse
for main in (node.main, node.mock_main, node.guard_main, node.estimator_main):
    try: main()
    except SystemExit as ended: print(ended.code)
"""


def test_the_executables_end_with_status_2_before_rclpy_is_imported():
    ended = subprocess.run([sys.executable, "-c", REFUSED], capture_output=True, text=True, timeout=60, check=True)
    assert ended.stdout.split() == ["2"] * 4
    assert ended.stderr == "error: two installations of ROS 2\n" * 4


def test_the_real_wheels_beside_a_sourced_installation_are_refused(tmp_path):
    try:
        installation.distribution("ros-rclpy")
    except PackageNotFoundError as error:
        pytest.skip(f"the wheels of ROS 2 are not installed: {error}")
    _make(tmp_path / "lib/librcl.so")
    ended = subprocess.run(
        [sys.executable, "-c", "from wbc_controller.node import main; main()"],
        env=os.environ | {"AMENT_PREFIX_PATH": str(tmp_path)},
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert ended.returncode == 2
    assert f"a sourced one in {tmp_path}" in ended.stderr
