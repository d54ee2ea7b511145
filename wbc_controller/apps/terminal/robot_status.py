"""Newest status of a robot."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from wbc_controller.apps.terminal.session import Session
from wbc_controller.settings import Settings

_WINDOW = 2.0  # wall time, s
_TASK_PERIODS = 3.0  # for the first status, in periods of the diagnostics


@dataclass(frozen=True, slots=True)
class RobotStatus:
    """Newest messages."""

    status: Any  # diagnostic_msgs/DiagnosticStatus of the controller
    rate: float  # per second of wall time; NaN if unknown
    tasks: Mapping[str, tuple[Any | None, Any | None]]  # value and reference of each task
    guard: str  # empty without a guard

    @property
    def values(self) -> dict[str, str]:
        """Values of the status by key."""
        return {value.key: value.value for value in self.status.values}

    @property
    def level(self) -> int:
        """0 for ok, 1 for a warning, 2 for an error."""
        level = self.status.level  # some codecs return a byte string
        return level[0] if isinstance(level, bytes | bytearray) else int(level)


class StatusListener:
    """Subscribes to the status, and counts the cycles."""

    def __init__(self, session: Session, settings: Settings) -> None:
        self._session, self._settings = session, settings
        self._status: Any = None
        self._cycles: deque[tuple[float, int]] = deque()
        session.listen("controller", "state")
        session.listen("controller", "diagnostics", depth=1000)
        session.listen("guard", "state")
        self._task_topics = [
            (name, key)
            for name in settings.tasks
            for key in ("task_value", "task_reference")
            if ("controller", key, name) in session.topics
        ]
        for name, key in self._task_topics:
            session.listen("controller", key, name)

    def wait_for_first(self) -> None:
        """Wait for a complete status; raise `NoAnswer` without a controller."""
        self._session.wait_for_controller()
        self._session.until(
            lambda: self.read_statuses() and len(self._cycles) > 1, "the controller has stopped publishing its status"
        )
        if self._session.mode().startswith(("active", "holding")):
            deadline = time.monotonic() + _TASK_PERIODS / self._settings.control.diagnostics_rate
            while time.monotonic() < deadline and not all(self._newest(*place) for place in self._task_topics):
                time.sleep(0.02)

    def read_statuses(self) -> list[Any]:
        """Return the new statuses, oldest first."""
        now, statuses = time.monotonic(), list(self._session.statuses())
        for status in statuses:
            self._status = status
            self._cycles.append((now, int(next(value.value for value in status.values if value.key == "cycle"))))
        while len(self._cycles) > 2 and now - self._cycles[0][0] > _WINDOW:
            self._cycles.popleft()
        return statuses

    def newest(self) -> RobotStatus | None:
        """Return the status as of the last `read_statuses`, or None."""
        if self._status is None:
            return None
        (first, before), (last, after) = self._cycles[0], self._cycles[-1]
        guard = self._session.newest("guard", "state")
        tasks = {
            name: (self._newest(name, "task_value"), self._newest(name, "task_reference"))
            for name in self._settings.tasks
        }
        rate = (after - before) / (last - first) if last > first else float("nan")
        return RobotStatus(self._status, rate, tasks, "" if guard is None else str(guard.data))

    def _newest(self, name: str, key: str) -> Any | None:
        return self._session.newest("controller", key, name) if (name, key) in self._task_topics else None
