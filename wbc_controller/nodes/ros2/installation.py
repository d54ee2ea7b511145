"""Detection of two ROS 2 installations in one process."""

import importlib.util
import os
import sys
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from wbc_controller.errors import ConfigurationError

_WHEEL = "ros-rclpy"  # distribution of the wheel with rclpy
_LIBRARY = "librcl.so"  # library of every rclpy installation


def refuse_mixed_installations() -> None:
    """Check, without importing rclpy, that this process loads only one ROS 2.

    Installed wheels and a sourced ROS 2 (libraries of both, undefined behaviour) raise `ConfigurationError`.
    """
    try:
        wheels = Path(str(distribution(_WHEEL).locate_file("")))
    except PackageNotFoundError:
        return
    sourced = _find_sourced(wheels)
    if sourced is not None:
        raise ConfigurationError(
            f"two installations of ROS 2: wheels of PyPI in {wheels}, and a sourced one in {sourced}. Use only one: a "
            "shell without a sourced ROS 2, or a virtual environment without the extra 'ros2' of wbc_controller; see "
            "docs/ros2.md"
        )


def _find_sourced(wheels: Path) -> Path | None:
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
