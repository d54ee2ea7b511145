"""Entry points of the ROS 2 executables, which run the nodes of ``ros2/`` and report it if rclpy is missing."""

from __future__ import annotations

import sys


def main() -> None:
    """Run the controller's node: the executable `wbc_controller`."""
    try:
        from wbc_controller.ros2 import controller_node, process
    except ImportError as error:
        sys.exit(_without_ros2("wbc run g1", error))
    sys.exit(process.run(controller_node.serve))


def mock_main() -> None:
    """Run the mock robot's node: the executable `mock_robot`."""
    try:
        from wbc_controller.ros2 import mock_node, process
    except ImportError as error:
        sys.exit(_without_ros2("wbc mock g1", error))
    sys.exit(process.run(mock_node.serve))


def guard_main() -> None:
    """Run the guard's node: the executable `guard`."""
    try:
        from wbc_controller.ros2 import guard_node, process
    except ImportError as error:
        sys.exit(_without_ros2("wbc guard g1", error))
    sys.exit(process.run(guard_node.serve))


def _without_ros2(instead: str, error: ImportError) -> int:
    """Print what to do without ROS 2, and return the exit status."""
    version = ".".join(map(str, sys.version_info[:2]))
    print(
        f"error: this Python ({version}) finds no ROS 2: {error}\n"
        f"Source it first (. /opt/ros/jazzy/setup.bash), with the Python it was made for; see docs/ros2.md.\n"
        f"Without ROS 2 the same runs as: {instead}",
        file=sys.stderr,
    )
    return 2
