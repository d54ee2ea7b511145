"""Settings changed between cycles."""

import logging
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from wbc_controller.controller.build.estimation import disturbance_limits
from wbc_controller.controller.build.references import make_board_plan
from wbc_controller.errors import ConfigurationError
from wbc_controller.estimation.disturbance_observer import DisturbanceLimits
from wbc_controller.inverse_dynamics.references.board import BoardPlan
from wbc_controller.inverse_dynamics.whole_body_qp import WholeBodyQP
from wbc_controller.settings import Settings
from wbc_controller.settings.files import parse_settings
from wbc_controller.settings.nesting import merged

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class LivePart:
    """Objects derived from the settings that can change in a running loop."""

    settings: Settings
    board: BoardPlan  # plans of references, gains and limits
    disturbance: DisturbanceLimits


class LiveSettings:
    """Settings that any thread may change; the loop applies `newest`, their live part, between two cycles."""

    def __init__(self, settings: Settings, qp: WholeBodyQP) -> None:
        """Start with the configured settings of a quadratic program."""
        self._qp = qp
        self.settings = settings  # with all accepted changes
        self.newest = self._derive(settings)
        self.changed: Callable[[], None] = lambda: None  # called after each change, in its thread
        self._configured = settings
        self._lock = threading.Lock()
        #: Last prepared change, its base settings, and the result.
        self._prepared: tuple[Any, Settings, Any] = (None, settings, None)

    def prepare(self, change: Mapping[str, Any], source: str) -> None:
        """Precompute `accept` in another thread; errors as in `validated`."""
        base = self.settings
        self._prepared = (change, base, self.validated(change, source))

    def accept(self, change: Mapping[str, Any], source: str) -> None:
        """Apply a change completely, or raise an error as in `validated`."""
        prepared, base, result = self._prepared
        with self._lock:
            ready = prepared is change and base is self.settings
            settings, live, differences = result if ready else self.validated(change, source)
            if not differences:
                return
            self.settings, self.newest = settings, live
        _log.info("%s: %s", source, ", ".join(differences))
        self.changed()

    def replace_all(self, settings: Settings) -> None:
        """Replace all settings, for example by recorded ones."""
        live = self._derive(settings)
        with self._lock:
            self.settings, self.newest = settings, live

    def _derive(self, settings: Settings) -> LivePart:
        return LivePart(settings, make_board_plan(settings, self._qp), disturbance_limits(settings))

    def validated(self, change: Mapping[str, Any], source: str) -> tuple[Settings, LivePart, tuple[str, ...]]:
        """Return the results of a change, nested as in a configuration file; errors name its source."""
        settings = parse_settings(merged(self.settings.model_dump(exclude_unset=True), change), source)
        differences = list(_differences(self.settings, settings))
        fixed = [key for key, live, *_ in differences if not live]
        if fixed:
            raise ConfigurationError(
                f"{source}: {', '.join(fixed)}: read only when the controller is configured; reconfigure it"
            )
        beyond = list(_out_of_live_range(self._configured, self.settings, settings))
        if beyond:
            raise ConfigurationError(f"{source}: {'; '.join(beyond)}")
        return settings, self._derive(settings), tuple(f"{key}: {old} -> {new}" for key, _, old, new in differences)


def _differences(old: BaseModel, new: BaseModel, prefix: str = "") -> Iterator[tuple[str, bool, Any, Any]]:
    """Yield each changed key: dotted key, True if live, old value, new value."""
    live: tuple[str, ...] = getattr(old, "live", ())
    for name in type(old).model_fields:
        before, after, key = getattr(old, name), getattr(new, name), f"{prefix}{name}"
        if before == after:
            continue
        pairs = [(key, before, after)]
        if isinstance(before, dict):  # the tasks, or the contacts
            entries = dict.fromkeys([*before, *after])
            pairs = [(f"{key}.{entry}", before.get(entry), after.get(entry)) for entry in entries]
        for key, a, b in pairs:
            if isinstance(a, BaseModel) and type(a) is type(b):
                yield from _differences(a, b, f"{key}.")
            elif a != b:
                yield key, name in live, a, b


def _out_of_live_range(configured: BaseModel, old: BaseModel, new: BaseModel, prefix: str = "") -> Iterator[str]:
    for name in type(new).model_fields:
        parts = getattr(configured, name), getattr(old, name), getattr(new, name)
        if all(isinstance(part, BaseModel) for part in parts):
            yield from _out_of_live_range(*parts, f"{prefix}{name}.")
    for name, (lower, upper) in getattr(new, "live_ranges", {}).items():
        configured_value, value = getattr(configured, name), getattr(new, name)
        low = configured_value if lower is None else min(lower, configured_value)
        high = configured_value if upper is None else max(upper, configured_value)
        if value != getattr(old, name) and not (low <= value <= high):
            yield f"{prefix}{name} = {value:g}: valid in a running controller: {low:g} to {high:g}"
