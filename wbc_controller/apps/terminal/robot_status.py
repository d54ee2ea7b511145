"""The newest status of a robot's nodes, collected from their topics for `wbc status` and the page."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from wbc_controller.apps.terminal.session import Session
from wbc_controller.settings import Settings

#: Wall time over which cycles are counted, s.
_WINDOW = 2.0
#: Wall time for which the first status waits for the tasks, in periods of the diagnostics.
_PERIODS = 3.0


@dataclass(frozen=True, slots=True)
class RobotStatus:
    """The newest messages of a robot's nodes."""

    status: Any  # the controller's diagnostic_msgs/DiagnosticStatus
    rate: float  # cycles per second of wall time; NaN if not known yet
    tasks: Mapping[str, tuple[Any | None, Any | None]]  # messages of the value and the reference of each task, by name
    guard: str  # state of the guard; empty without a guard

    @property
    def values(self) -> dict[str, str]:
        """The values of the status, by key."""
        return {value.key: value.value for value in self.status.values}

    @property
    def level(self) -> int:
        """0 for ok, 1 for a warning, 2 for an error."""
        level = self.status.level  # some codecs return a byte string
        return level[0] if isinstance(level, bytes | bytearray) else int(level)


class StatusListener:
    """Listens to the topics of a robot's status, and counts the cycles."""

    def __init__(self, session: Session, settings: Settings) -> None:
        self._session, self._settings = session, settings
        self._status: Any = None
        self._cycles: deque[tuple[float, int]] = deque()
        session.listen("controller", "state")
        session.listen("controller", "diagnostics", depth=1000)
        session.listen("guard", "state")
        self._places = [
            (name, key)
            for name in settings.tasks
            for key in ("task_value", "task_reference")
            if ("controller", key, name) in session.topics
        ]
        for name, key in self._places:
            session.listen("controller", key, name)

    def begin(self) -> None:
        """Wait for the messages of a complete first status.

        Raises:
            NoAnswer: if there is no controller.
        """
        self._session.wait_for_controller()
        self._session.until(lambda: self.take() and len(self._cycles) > 1, "the controller publishes no more statuses")
        if self._session.mode().startswith(("active", "holding")):
            deadline = time.monotonic() + _PERIODS / self._settings.control.diagnostics_rate
            while time.monotonic() < deadline and not all(self._newest(*place) for place in self._places):
                time.sleep(0.02)

    def take(self) -> list[Any]:
        """Take the controller's statuses since the last call, oldest first."""
        now, came = time.monotonic(), list(self._session.statuses())
        for status in came:
            self._status = status
            self._cycles.append((now, int(next(value.value for value in status.values if value.key == "cycle"))))
        while len(self._cycles) > 2 and now - self._cycles[0][0] > _WINDOW:
            self._cycles.popleft()
        return came

    def newest(self) -> RobotStatus | None:
        """Return the status as of the last `take`; None before the controller's first one."""
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
        return self._session.newest("controller", key, name) if (name, key) in self._places else None
