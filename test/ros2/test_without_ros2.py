"""The executables where there is no ROS 2."""

import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    ("main", "instead"), [("main", "wbc run g1"), ("mock_main", "wbc mock g1"), ("guard_main", "wbc guard g1")]
)
def test_the_executables_say_how_to_do_without(main, instead):
    # None in sys.modules makes an import fail, on machines that have ROS 2 too.
    code = f"import sys; sys.modules['rclpy'] = None; from wbc_controller.node import {main}; {main}()"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 2
    assert "finds no ROS 2" in ended.stderr
    assert instead in ended.stderr
    assert "Traceback" not in ended.stderr
