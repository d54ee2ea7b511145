"""The executables without ROS 2."""

import signal
import subprocess
import sys

import pytest

#: Equivalent commands without ROS 2, by function of the executable.
COMMANDS = {"main": "run", "mock_main": "mock", "guard_main": "guard", "estimator_main": "estimate"}


#: None in sys.modules makes an import fail, also with an installed ROS 2.
WITHOUT = f"""
import sys
sys.modules["rclpy"] = None
from wbc_controller import node
for main in {tuple(COMMANDS)}:
    try: getattr(node, main)()
    except SystemExit as ended: print(ended.code)
"""


def test_the_executables_say_how_to_do_without():
    ended = subprocess.run([sys.executable, "-c", WITHOUT], capture_output=True, text=True, timeout=60, check=True)
    assert ended.stdout.split() == ["2"] * 4
    assert ended.stderr.count("ROS 2 not found") == 4
    for command in COMMANDS.values():
        assert f"wbc {command} g1" in ended.stderr
    assert "Traceback" not in ended.stderr


def test_the_mock_robot_without_mujoco_reports_its_extra():
    pytest.importorskip("rclpy", reason="needs rclpy: pip install 'wbc_controller[ros2]', or a sourced ROS 2")
    code = "import sys; sys.modules['mujoco'] = None; from wbc_controller.node import mock_main; mock_main()"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 2
    assert ended.stderr.splitlines()[-1].endswith("install with: pip install 'wbc_controller[mock]'")
    assert "Traceback" not in ended.stderr


#: Sends the signal during the import of a node's modules.
INTERRUPTED = """
import os, signal, sys
class Finder:
    def find_spec(self, name, *rest):
        if name == "wbc_controller.nodes.ros2.process":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
from wbc_controller.node import main
main()
"""


def test_ctrl_c_while_a_node_is_imported_ends_it_without_a_traceback():
    ended = subprocess.run([sys.executable, "-c", INTERRUPTED], capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == -signal.SIGINT
    assert ended.stderr == ""
