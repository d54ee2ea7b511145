"""Finding files that packages install: robot models, and this package's own configurations."""

from __future__ import annotations

import importlib.metadata
import os
from pathlib import Path

from wbc_controller.errors import ConfigurationError

PACKAGE_SCHEME = "package://"


def locate(uri: str, key: str = "robot.urdf") -> Path:
    """Find a file given by path or as ``package://<distribution>/<path below its share folder>``.

    The distribution is a Python one, such as ``example-robot-data``, with its files below ``share/<distribution>/``, or
    a ROS 2 package on ``AMENT_PREFIX_PATH``.

    Args:
        uri: path or ``package://`` address of the file.
        key: the configuration key that names the file, for the error.

    Raises:
        ConfigurationError: if there is no such file.
    """
    if not uri.startswith(PACKAGE_SCHEME):
        path = Path(uri).expanduser()
    else:
        package, _, rest = uri.removeprefix(PACKAGE_SCHEME).partition("/")
        try:
            path = share_folder(package) / rest
        except ConfigurationError as error:
            raise ConfigurationError(f"{key} = {uri!r}: {error}") from error
    if not path.is_file():
        raise ConfigurationError(f"{key} = {uri!r}: there is no file {path}")
    return path


def share_folder(package: str) -> Path:
    """Find the share folder of a Python distribution or of a ROS 2 package.

    Raises:
        ConfigurationError: if neither is installed.
    """
    for prefix in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        folder = Path(prefix) / "share" / package
        if folder.is_dir():
            return folder
    try:
        distribution = importlib.metadata.distribution(package)
    except (importlib.metadata.PackageNotFoundError, ValueError):  # ValueError: the name is empty
        raise ConfigurationError(
            f"package {package!r} is not installed; robot models come with: pip install 'wbc_controller[robots]'"
        ) from None
    marker = f"share/{package}/"
    for file in distribution.files or ():
        before, found, _ = str(file).partition(marker)
        if found:
            return Path(str(distribution.locate_file(before + marker)))
    raise ConfigurationError(f"package {package!r} has no folder share/{package}")
