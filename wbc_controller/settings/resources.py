"""Files of robot models: search and reading."""

import importlib.metadata
import os
from functools import cache
from pathlib import Path

from wbc_controller.errors import ConfigurationError

PACKAGE_SCHEME = "package://"
_LONGEST_NAME = 300  # longest name shown in full in messages, characters


def locate(uri: str, key: str = "robot.urdf") -> Path:
    """Find a file by path, or by ``package://<package>/<path in its share folder>``.

    The package is a ROS 2 package on ``AMENT_PREFIX_PATH``, or a Python distribution such as ``example-robot-data``.
    `ConfigurationError` begins with the configuration key.
    """
    package, _, rest = uri.removeprefix(PACKAGE_SCHEME).partition("/")
    try:
        path = share_folder(package) / rest if uri.startswith(PACKAGE_SCHEME) else Path(uri).expanduser()
    except (ConfigurationError, RuntimeError) as error:  # RuntimeError: unknown user
        raise ConfigurationError(f"{key} = {shown(uri)}: {error}") from error
    if not os.path.isfile(path):  # False also for invalid names
        raise ConfigurationError(f"{key} = {shown(uri)}: file {shown(path)} does not exist")
    return path


def folder_of(urdf: str) -> Path | None:
    """Return the folder of ``robot.urdf``, for relative paths of meshes; None without a file."""
    return locate(urdf).parent if urdf else None


def read_text(path: Path, subject: str, largest: int) -> str:
    """Read a UTF-8 file of at most `largest` characters; `ConfigurationError` begins with the subject."""
    try:
        with path.open(encoding="utf-8") as file:
            text = file.read(largest + 1)
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{subject}: cannot be read: {error}") from error
    if len(text) > largest:
        raise ConfigurationError(f"{subject}: longer than {largest} characters")
    return text


def shown(name: str | Path) -> str:
    """Quote a name for a message, shortened in the middle."""
    text = repr(name) if isinstance(name, str) else str(name)
    return text if len(text) <= _LONGEST_NAME else f"{text[:100]}…{text[-100:]} ({len(text)} characters)"


def share_folder(package: str) -> Path:
    """Find the share folder of an installed ROS 2 package or Python distribution, or raise `ConfigurationError`."""
    for prefix in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        folder = Path(prefix) / "share" / package
        if os.path.isdir(folder):  # False also if the name is too long
            return folder
    return _folder_of_distribution(package)


@cache
def _folder_of_distribution(package: str) -> Path:
    try:
        distribution = importlib.metadata.distribution(package)
    except (importlib.metadata.PackageNotFoundError, ValueError):  # ValueError: the name is empty
        raise ConfigurationError(
            f"package {shown(package)} is not installed, neither as a ROS 2 package on AMENT_PREFIX_PATH nor as a "
            "Python distribution; example-robot-data: pip install 'wbc_controller[robots]'"
        ) from None
    marker = f"share/{package}/"
    for file in distribution.files or ():
        before, found, _ = str(file).partition(marker)
        if found:
            return Path(str(distribution.locate_file(before + marker)))
    raise ConfigurationError(f"package {package!r} has no folder share/{package}")
