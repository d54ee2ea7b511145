"""Optional libraries and their extras."""

import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager

from wbc_controller.errors import ConfigurationError

#: The extra of each optional library, by the library's import name.
EXTRAS = {
    "cyclonedds": "dds",
    "mujoco": "mock",
    "plotly": "plots",
    "joblib": "campaign",
    "hypothesis": "fuzz",
    "viser": "view",
    "msgspec": "view",
    "websockets": "view",
    "trimesh": "view",
    "fast_simplification": "view",
}


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
