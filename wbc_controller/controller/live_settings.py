"""Settings changed between cycles."""

import logging
import operator
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
        self._prepared = (change, self.settings, self.validated(change, source))

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
        fixed = ", ".join(key for key, _, _, live, _ in differences if not live)
        if fixed:
            raise ConfigurationError(f"{source}: {fixed}: read only when the controller is configured; reconfigure it")
        beyond = []
        for key, _, value, _, (lower, upper) in (each for each in differences if each[-1] is not None):
            configured = operator.attrgetter(key)(self._configured)
            low = configured if lower is None else min(lower, configured)
            high = configured if upper is None else max(upper, configured)
            if not (low <= value <= high):
                beyond.append(f"{key} = {value:g}: valid in a running controller: {low:g} to {high:g}")
        if beyond:
            raise ConfigurationError(f"{source}: {'; '.join(beyond)}")
        return settings, self._derive(settings), tuple(f"{key}: {old} -> {new}" for key, old, new, *_ in differences)


def _differences(old: BaseModel, new: BaseModel, prefix: str = "") -> Iterator[tuple[str, Any, Any, bool, Any]]:
    """Yield each changed key: dotted key, old value, new value, True if live, and live range or None."""
    live, ranges = getattr(old, "live", ()), getattr(old, "live_ranges", {})
    for name in type(old).model_fields:
        before, after, key = getattr(old, name), getattr(new, name), f"{prefix}{name}"
        if before == after:
            continue
        pairs = [(key, before, after)]
        if isinstance(before, dict):  # the tasks, or the contacts
            pairs = [(f"{key}.{entry}", before.get(entry), after.get(entry)) for entry in {**before, **after}]
        for key, a, b in pairs:
            if isinstance(a, BaseModel) and type(a) is type(b):
                yield from _differences(a, b, f"{key}.")
            elif a != b:
                yield key, a, b, name in live, ranges.get(name)
