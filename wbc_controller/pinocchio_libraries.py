"""Detection of two Pinocchio installations in one process."""

import functools
import logging
import os
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

_log = logging.getLogger(__name__)

_REMEDY = (
    "They may be incompatible with each other or with this NumPy. Use one: start in a shell that has not sourced "
    "ROS 2, or uninstall the wheel (pip uninstall pin) or ROS 2's package (ros-<distribution>-pinocchio); "
    "see docs/ros2.md"
)
#: Libraries of the Pinocchio family, each compiled against exact versions of the others.
_LIBRARY = re.compile(r"lib(pinocchio|coal|hpp-fcl|eigenpy)\w*\.so[.\d]*|pinocchio_pywrap\w*\..*so")
_MAPPED = Path("/proc/self/maps")


@functools.cache
def warn_of_two_installations() -> None:
    """Log `two_installations`, once in a process."""
    warning = two_installations()
    if warning:
        _log.warning("%s", warning)


def two_installations() -> str:
    """Return a warning if this process has loaded, or may load, two installations of Pinocchio; empty if not.

    ``PYTHONPATH`` of a sourced ROS 2 precedes the virtual environment, ``LD_LIBRARY_PATH`` the libraries beside the
    wheel (its RUNPATH). A mixture has undefined behaviour.
    """
    loaded = _prefixes(_loaded())
    if len(loaded) > 1:
        return f"libraries of two Pinocchio installations are loaded: from {' and '.join(loaded)}. {_REMEDY}"
    folders = filter(None, os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep))
    libraries = [path for folder in folders for path in sorted(Path(folder).glob("libpinocchio*.so"))]
    modules = [path for folder in sys.path if (path := Path(folder, "pinocchio", "__init__.py")).exists()]
    found = _prefixes([*modules, *libraries])
    if len(found) > 1:
        return f"there are two Pinocchio installations: in {' and '.join(found)}; the first is used. {_REMEDY}"
    return ""


def _loaded() -> Iterator[Path]:
    if _MAPPED.exists():  # on Linux
        for line in _MAPPED.read_text(encoding="utf-8", errors="replace").splitlines():
            path = Path(line.split(maxsplit=5)[-1])
            if _LIBRARY.fullmatch(path.name):
                yield path


def _prefixes(paths: Iterable[Path]) -> list[str]:
    """Return the installation prefix of each library or module, ``<prefix>/lib/…``, without duplicates."""
    return list(dict.fromkeys(str(path.resolve()).rpartition("/lib/")[0] for path in paths))
