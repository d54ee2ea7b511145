"""Detection of two installations of ROS 2 in one process: the wheels of the extra ``ros2``, and a sourced one."""

from __future__ import annotations

import importlib.util
import os
import sys
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from wbc_controller.errors import ConfigurationError

#: Name of the wheel with rclpy: no other installation of ROS 2 has a Python distribution of this name.
_WHEEL = "ros-rclpy"
#: A library that every installation of rclpy has.
_LIBRARY = "librcl.so"


def refuse_mixture() -> None:
    """Check, without importing rclpy, that this process would load only one ROS 2.

    The wheels put their libraries on ``LD_LIBRARY_PATH``, in any order beside those of a sourced ROS 2. The process
    would then load libraries of both, with undefined behaviour.

    Raises:
        ConfigurationError: if the wheels are installed and a ROS 2 is sourced, with both paths and the remedy.
    """
    try:
        wheels = Path(str(distribution(_WHEEL).locate_file("")))
    except PackageNotFoundError:
        return
    sourced = _sourced(wheels)
    if sourced is not None:
        raise ConfigurationError(
            f"two installations of ROS 2 would be mixed: wheels of PyPI in {wheels}, and a sourced one in {sourced}. "
            "Use one: start this in a shell that has not sourced ROS 2, or use a virtual environment without the extra "
            "'ros2' of wbc_controller; see docs/ros2.md"
        )


def _sourced(wheels: Path) -> Path | None:
    """Folder of a ROS 2 beside the wheels, from the environment or from the place of rclpy; None if there is none."""
    libraries = [Path(prefix, "lib") for prefix in _paths("AMENT_PREFIX_PATH")] + _paths("LD_LIBRARY_PATH")
    own = Path(sys.prefix, "lib").resolve()
    for folder in libraries:
        if (folder / _LIBRARY).exists() and folder.resolve() != own:
            return folder.parent
    rclpy = importlib.util.find_spec("rclpy")
    if rclpy is not None and rclpy.origin is not None:
        packages = Path(rclpy.origin).parents[1]
        if packages.resolve() != wheels.resolve():
            return packages
    return None


def _paths(variable: str) -> list[Path]:
    return [Path(path) for path in os.environ.get(variable, "").split(os.pathsep) if path]
