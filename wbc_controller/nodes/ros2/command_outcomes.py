"""Outcomes of service commands."""

from __future__ import annotations

import threading
from collections.abc import Callable

from wbc_controller.controller.report import CycleReport
from wbc_controller.records import Mode

_IN_CONTROL = frozenset({Mode.ACTIVE, Mode.HOLDING})  # modes with torques of the solution
#: By service, its command and the confirming modes.
SERVICES: dict[str, tuple[str, frozenset[Mode]]] = {
    "activate": ("activate", _IN_CONTROL),
    "deactivate": ("deactivate", frozenset({Mode.INACTIVE})),
    "reset": ("reset", frozenset({Mode.INACTIVE})),
    "stop": ("estop", frozenset({Mode.FAULT})),
}

RECORD = "record"  # service

_LONGEST_WAIT = 1000  # cycles; then the command counts as dropped


class CommandOutcomes:
    """Pending service commands of the loop."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: list[_PendingCommand] = []

    def submit(self, word: str, send: Callable[[], None], respond: Callable[[bool, str], None]) -> None:
        """Send a command; `respond` is called later with success and a message."""
        with self._lock:
            self._waiting.append(_PendingCommand(word, respond))
            send()

    def observe(self, report: CycleReport) -> None:
        """Process the report of a cycle, on the loop's thread."""
        if not self._waiting:
            return
        with self._lock:
            self._waiting = [waiting for waiting in self._waiting if not waiting.observe(report)]

    def end(self, reason: str) -> None:
        """Respond to all pending commands after the last cycle."""
        with self._lock:
            ended, self._waiting = self._waiting, []
        for waiting in ended:
            waiting.respond(False, reason)


class _PendingCommand:
    def __init__(self, word: str, respond: Callable[[bool, str], None]) -> None:
        self.respond = respond
        self._word = word
        self._cycles = 0
        self._accepted = False  # by a cycle

    def observe(self, report: CycleReport) -> bool:
        """Process the report of a cycle; return True after the response."""
        self._cycles += 1
        if not self._accepted:
            # Decoding on another thread may take some cycles.
            if self._word not in report.inputs.requests.commands:
                if self._cycles < _LONGEST_WAIT:
                    return False
                self.respond(
                    False, f"command {self._word!r} was dropped: not processed in {self._cycles} cycles; send it again"
                )
                return True
            refusals = [text for text in report.refused if text.startswith(f"command {self._word!r}")]
            if refusals:
                self.respond(False, refusals[-1])
                return True
            self._accepted = True
        if self._word == "deactivate" and report.mode in _IN_CONTROL:  # the torques ramp down
            return False
        state = report.mode.value
        if report.fault is not None:
            state += f" {report.fault.code}: {report.fault.sentence}"
        expected = next(modes for word, modes in SERVICES.values() if word == self._word)
        self.respond(report.mode in expected, state)
        return True
