"""Finding and reading files: robot models, and this package's own configurations."""

from __future__ import annotations

import importlib.metadata
import os
from pathlib import Path

from wbc_controller.errors import ConfigurationError

PACKAGE_SCHEME = "package://"
#: Longest name that an error shows in full, in characters.
_LONGEST_NAME = 300


def locate(uri: str, key: str = "robot.urdf") -> Path:
    """Find a file given by path, or as ``package://<distribution>/<path below its share folder>``.

    The distribution is a Python one, such as ``example-robot-data``, with its files below ``share/<distribution>/``, or
    a ROS 2 package on ``AMENT_PREFIX_PATH``.

    Raises:
        ConfigurationError: if there is no such file; the message begins with the key.
    """
    if not uri.startswith(PACKAGE_SCHEME):
        try:
            path = Path(uri).expanduser()
        except RuntimeError as error:  # there is no such user
            raise ConfigurationError(f"{key} = {shown(uri)}: {error}") from error
    else:
        package, _, rest = uri.removeprefix(PACKAGE_SCHEME).partition("/")
        try:
            path = share_folder(package) / rest
        except ConfigurationError as error:
            raise ConfigurationError(f"{key} = {shown(uri)}: {error}") from error
    if not is_file(path):
        raise ConfigurationError(f"{key} = {shown(uri)}: there is no file {shown(path)}")
    return path


def read_text(path: Path, subject: str, largest: int) -> str:
    """Read a text file of at most `largest` characters; the subject names the file in errors.

    Raises:
        ConfigurationError: if the file cannot be read, is no UTF-8, or is longer.
    """
    try:
        with path.open(encoding="utf-8") as file:
            text = file.read(largest + 1)
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{subject}: cannot be read: {error}") from error
    if len(text) > largest:
        raise ConfigurationError(f"{subject}: is longer than {largest} characters")
    return text


def is_file(path: Path) -> bool:
    """Whether there is such a file; False also where the system refuses the name, such as one that is too long."""
    try:
        return path.is_file()
    except OSError:
        return False


def shown(name: str | Path) -> str:
    """A name for an error message, in quotes if it is a string, and with its middle left out if it is very long."""
    text = repr(name) if isinstance(name, str) else str(name)
    return text if len(text) <= _LONGEST_NAME else f"{text[:100]}…{text[-100:]} ({len(text)} characters)"


def share_folder(package: str) -> Path:
    """Find the share folder of a Python distribution or of a ROS 2 package.

    Raises:
        ConfigurationError: if neither is installed.
    """
    for prefix in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        folder = Path(prefix) / "share" / package
        try:
            if folder.is_dir():
                return folder
        except OSError:  # the name is too long
            break
    try:
        distribution = importlib.metadata.distribution(package)
    except (importlib.metadata.PackageNotFoundError, ValueError):  # ValueError: the name is empty
        raise ConfigurationError(
            f"package {shown(package)} is not installed, neither as a ROS 2 package on AMENT_PREFIX_PATH nor as a "
            "Python distribution; example-robot-data comes with: pip install 'wbc_controller[robots]'"
        ) from None
    marker = f"share/{package}/"
    for file in distribution.files or ():
        before, found, _ = str(file).partition(marker)
        if found:
            return Path(str(distribution.locate_file(before + marker)))
    raise ConfigurationError(f"package {package!r} has no folder share/{package}")
