"""Optional libraries and their extras."""

import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager

from wbc_controller.errors import ConfigurationError

#: Optional libraries, by their import names, of each extra.
_LIBRARIES = {
    "dds": "cyclonedds",
    "mock": "mujoco",
    "plots": "plotly",
    "campaign": "joblib",
    "fuzz": "hypothesis",
    "view": "viser msgspec websockets trimesh fast_simplification",
}
EXTRAS = {library: extra for extra, libraries in _LIBRARIES.items() for library in libraries.split()}


def require_libraries(*names: str) -> None:
    """Require libraries, without importing them; `ConfigurationError` names the command that installs missing ones."""
    missing = [name for name in names if importlib.util.find_spec(name) is None]
    if missing:
        raise ConfigurationError(_installation(missing))


@contextmanager
def optional_libraries() -> Iterator[None]:
    """Replace the error of a missing optional library by `ConfigurationError` with the command that installs it."""
    try:
        yield
    except ModuleNotFoundError as error:
        name = (error.name or "").partition(".")[0]
        if name not in EXTRAS:
            raise
        raise ConfigurationError(_installation([name])) from error


def _installation(missing: list[str]) -> str:
    extras = ",".join(dict.fromkeys(EXTRAS[name] for name in missing))
    are = "is" if len(missing) == 1 else "are"
    return f"{', '.join(missing)} {are} not installed; install with: pip install 'wbc_controller[{extras}]'"
