"""Watches a robot for `wbc status`: keeps the newest of what its nodes say, and counts the cycles."""

from __future__ import annotations

import time
from collections import deque
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from wbc_controller.apps.terminal.session import Session
from wbc_controller.apps.terminal.status_view import Heard, status_view
from wbc_controller.settings import Settings

#: Wall time over which cycles are counted, s.
_WINDOW = 2.0
#: Wall time for which the first picture waits for the tasks, in periods of the diagnostics.
_PERIODS = 3.0


class Watch:
    """Listens to the topics that `status_view` shows."""

    def __init__(self, session: Session, settings: Settings) -> None:
        """Begin to listen.

        Args:
            session: on the robot's domain.
            settings: of the robot.
        """
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
        """Wait for what the first picture needs.

        Raises:
            NoAnswer: where there is no controller.
        """
        self._session.wait_for_controller()
        self._session.until(lambda: self.look() and len(self._cycles) > 1, "the controller says nothing more")
        if self._session.mode().startswith(("active", "holding")):
            deadline = time.monotonic() + _PERIODS / self._settings.control.diagnostics_rate
            while time.monotonic() < deadline and not all(
                self._session.newest("controller", key, name) for name, key in self._places
            ):
                time.sleep(0.02)

    def look(self) -> list[Any]:
        """Take the controller's statuses that have come since, oldest first."""
        now, came = time.monotonic(), list(self._session.statuses())
        for status in came:
            self._status = status
            self._cycles.append((now, int(next(value.value for value in status.values if value.key == "cycle"))))
        while len(self._cycles) > 2 and now - self._cycles[0][0] > _WINDOW:
            self._cycles.popleft()
        return came

    def picture(self) -> RenderableType:
        """The newest picture."""
        self.look()
        heard = self.heard()
        return Text("the controller has said nothing") if heard is None else status_view(self._settings, heard)

    def heard(self) -> Heard | None:
        """What was said last, up to the last `look`; None before the controller's first status."""
        if self._status is None:
            return None
        (first, before), (last, after) = self._cycles[0], self._cycles[-1]
        guard = self._session.newest("guard", "state")
        tasks = {
            name: (self._newest(name, "task_value"), self._newest(name, "task_reference"))
            for name in self._settings.tasks
        }
        rate = (after - before) / (last - first) if last > first else float("nan")
        return Heard(self._status, rate, tasks, "" if guard is None else str(guard.data))

    def _newest(self, name: str, key: str) -> Any | None:
        return self._session.newest("controller", key, name) if (name, key) in self._places else None
