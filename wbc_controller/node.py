"""Entry points of the ROS 2 executables.

The exit status is 2 if rclpy is missing, or if two installations of ROS 2 would be mixed.
"""

import importlib
import signal
import sys
from functools import partial
from typing import NoReturn

from wbc_controller.errors import ConfigurationError
from wbc_controller.extras import optional_libraries
from wbc_controller.nodes.ros2.installation import refuse_mixed_installations
from wbc_controller.pinocchio_libraries import two_installations


def _run(module: str, function: str, instead: str) -> NoReturn:
    # Ctrl-C during the imports ends the process without a traceback.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        refuse_mixed_installations()
        try:
            from wbc_controller.nodes.ros2 import process

            serve = getattr(importlib.import_module(f"wbc_controller.nodes.ros2.{module}"), function)
        except ImportError as error:
            raise ConfigurationError(_missing_ros2(instead, error)) from error
        with optional_libraries():
            status = process.run(serve)
    except ConfigurationError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    sys.exit(status)


#: Executables `wbc_controller`, `mock_robot`, `guard` and `base_estimator`.
main = partial(_run, "controller_node", "serve", "wbc run g1")
mock_main = partial(_run, "plain_nodes", "serve_mock", "wbc mock g1")
guard_main = partial(_run, "plain_nodes", "serve_guard", "wbc guard g1")
estimator_main = partial(_run, "plain_nodes", "serve_estimator", "wbc estimate g1")


def _missing_ros2(instead: str, error: ImportError) -> str:
    warning = two_installations()
    if warning:
        return f"{error}\n{warning}"
    version = ".".join(map(str, sys.version_info[:2]))
    return (
        f"ROS 2 not found by this Python ({version}): {error}\n"
        "Source ROS 2 (. /opt/ros/jazzy/setup.bash) and use its Python, or on x86-64 Linux install the wheels into a\n"
        "virtual environment (pip install 'wbc_controller[ros2]'); see docs/ros2.md.\n"
        f"Equivalent command without ROS 2: {instead}"
    )
