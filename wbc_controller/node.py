"""Entry points of the ROS 2 executables.

They run the nodes of ``ros2/``, and end with status 2 if rclpy is missing or two installations of ROS 2 would be mixed.
"""

from __future__ import annotations

import importlib
import signal
import sys
from typing import NoReturn

from wbc_controller.errors import ConfigurationError
from wbc_controller.extras import optional_libraries
from wbc_controller.nodes.ros2.installation import refuse_mixture
from wbc_controller.pinocchio_libraries import two_installations


def main() -> None:
    """Run the controller's node: the executable `wbc_controller`."""
    _run("controller_node", "serve", "wbc run g1")


def mock_main() -> None:
    """Run the mock robot's node: the executable `mock_robot`."""
    _run("plain_nodes", "serve_mock", "wbc mock g1")


def guard_main() -> None:
    """Run the guard's node: the executable `guard`."""
    _run("plain_nodes", "serve_guard", "wbc guard g1")


def estimator_main() -> None:
    """Run the node that estimates the base: the executable `base_estimator`."""
    _run("plain_nodes", "serve_estimator", "wbc estimate g1")


def _run(module: str, function: str, instead: str) -> NoReturn:
    # Until the node is up, Ctrl-C ends the process at once, without Python's traceback of the imports.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        refuse_mixture()
        try:
            from wbc_controller.nodes.ros2 import process

            serve = getattr(importlib.import_module(f"wbc_controller.nodes.ros2.{module}"), function)
        except ImportError as error:
            sys.exit(_without_ros2(instead, error))
        with optional_libraries():
            status = process.run(serve)
    except ConfigurationError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    sys.exit(status)


def _without_ros2(instead: str, error: ImportError) -> int:
    """Print what to do without ROS 2, and return the exit status."""
    version = ".".join(map(str, sys.version_info[:2]))
    warning = two_installations()
    if warning:
        print(f"error: {error}\n{warning}", file=sys.stderr)
        return 2
    print(
        f"error: this Python ({version}) finds no ROS 2: {error}\n"
        "Source it first (. /opt/ros/jazzy/setup.bash), with the Python it was made for, or on x86-64 Linux install\n"
        "its wheels into a virtual environment (pip install 'wbc_controller[ros2]'); see docs/ros2.md.\n"
        f"Without ROS 2 the same runs as: {instead}",
        file=sys.stderr,
    )
    return 2
