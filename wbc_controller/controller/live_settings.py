"""Settings that are changed while the controller runs: held to the schema, and applied by the loop between cycles."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from wbc_controller.controller.build.estimation import disturbance_limits
from wbc_controller.controller.build.references import make_board_plan
from wbc_controller.controller.build.safety import make_supervisor_limits
from wbc_controller.errors import ConfigurationError
from wbc_controller.estimation.disturbance_observer import DisturbanceLimits
from wbc_controller.inverse_dynamics.references.board import BoardPlan
from wbc_controller.inverse_dynamics.whole_body_qp import WholeBodyQP
from wbc_controller.safety.supervisor import SupervisorLimits
from wbc_controller.settings import Settings
from wbc_controller.settings.files import parse_settings
from wbc_controller.settings.nesting import merged

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class LivePart:
    """The part of the settings that a running loop uses.

    Attributes:
        settings: all of the settings.
        board: plans of references, gains and limits.
        supervisor: times and limits of the supervisor.
        state_timeout: oldest state that torques may be computed from, s.
        disturbance: speed and size of the disturbance estimate.
    """

    settings: Settings
    board: BoardPlan
    supervisor: SupervisorLimits
    state_timeout: float
    disturbance: DisturbanceLimits


class LiveSettings:
    """Takes changes of the settings, from any thread; the loop takes over the newest result, whole, between two cycles.

    Attributes:
        settings: the settings with all changes that were accepted.
        newest: their live part; another object after each change.
        changed: called after each change, on the thread that brought it.
    """

    def __init__(self, settings: Settings, derive: Callable[[Settings], LivePart]) -> None:
        """Begin with the settings of the controller; `derive` makes their live part, or raises `ConfigurationError`."""
        self.settings = settings
        self.newest = derive(settings)
        self.changed: Callable[[], None] = lambda: None
        self._configured = settings
        self._derive = derive
        self._lock = threading.Lock()
        #: The change that was prepared last, the settings that it was prepared for, and the result.
        self._prepared: tuple[Any, Settings, Any] = (None, settings, None)

    def check(self, change: Mapping[str, Any], source: str) -> None:
        """Check whether a change, a part of a configuration nested as in its file, would be accepted.

        Raises:
            ConfigurationError: if it would not, with its source and the reason.
        """
        self._validated(change, source)

    def prepare(self, change: Mapping[str, Any], source: str) -> None:
        """Do the work of `accept` ahead, on another thread than the one that will accept; as `check` otherwise."""
        base = self.settings
        self._prepared = (change, base, self._validated(change, source))

    def accept(self, change: Mapping[str, Any], source: str) -> None:
        """Take a change, whole or not at all; arguments and errors as for `check`."""
        prepared, base, result = self._prepared
        with self._lock:
            ready = prepared is change and base is self.settings
            settings, live, differences = result if ready else self._validated(change, source)
            if not differences:
                return
            self.settings, self.newest = settings, live
        _log.info("%s: %s", source, ", ".join(differences))
        self.changed()

    def replace_all(self, settings: Settings) -> None:
        """Take over settings that another controller of the same configuration had, as its recording says.

        Raises:
            ConfigurationError: if they do not fit the model.
        """
        live = self._derive(settings)
        with self._lock:
            self.settings, self.newest = settings, live

    def _validated(self, change: Mapping[str, Any], source: str) -> tuple[Settings, LivePart, tuple[str, ...]]:
        settings = parse_settings(merged(self.settings.model_dump(exclude_unset=True), change), source)
        differences = list(_differences(self.settings, settings))
        fixed = [key for key, live, *_ in differences if not live]
        if fixed:
            raise ConfigurationError(
                f"{source}: {', '.join(fixed)}: read only when the controller is configured; configure it anew for that"
            )
        beyond = list(_out_of_live_range(self._configured, self.settings, settings))
        if beyond:
            raise ConfigurationError(f"{source}: {'; '.join(beyond)}")
        return settings, self._derive(settings), tuple(f"{key}: {old} -> {new}" for key, _, old, new in differences)


def _differences(old: BaseModel, new: BaseModel, prefix: str = "") -> Iterator[tuple[str, bool, Any, Any]]:
    """Each key with another value: dotted, whether it may change live, the old and the new value."""
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
    """A sentence for each value that changes to one that is out of its range while the controller runs."""
    for name in type(new).model_fields:
        parts = getattr(configured, name), getattr(old, name), getattr(new, name)
        if all(isinstance(part, BaseModel) for part in parts):
            yield from _out_of_live_range(*parts, f"{prefix}{name}.")
    for name, (lower, upper) in getattr(new, "live_ranges", {}).items():
        configured_value, value = getattr(configured, name), getattr(new, name)
        low = configured_value if lower is None else min(lower, configured_value)
        high = configured_value if upper is None else max(upper, configured_value)
        if value != getattr(old, name) and not (low <= value <= high):
            yield f"{prefix}{name} = {value:g}: while the controller runs it may be from {low:g} to {high:g}"


def live_part(settings: Settings, qp: WholeBodyQP) -> LivePart:
    """Collect the settings that can change while a controller runs.

    Raises:
        ConfigurationError: if settings and model do not fit.
    """
    supervisor = make_supervisor_limits(settings, qp.model)
    plan = make_board_plan(settings, qp)
    return LivePart(settings, plan, supervisor, settings.safety.state_timeout, disturbance_limits(settings))
