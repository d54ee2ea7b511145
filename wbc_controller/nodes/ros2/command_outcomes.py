"""Outcomes of the commands that arrive by services, found in the reports of the cycles."""

from __future__ import annotations

import threading
from collections.abc import Callable

from wbc_controller.controller.report import CycleReport
from wbc_controller.records import Mode

#: Modes in which the torques follow the solutions, or hold.
_IN_CONTROL = frozenset({Mode.ACTIVE, Mode.HOLDING})
#: Command of each service, and the modes that confirm it.
SERVICES: dict[str, tuple[str, frozenset[Mode]]] = {
    "activate": ("activate", _IN_CONTROL),
    "deactivate": ("deactivate", frozenset({Mode.INACTIVE})),
    "reset": ("reset", frozenset({Mode.INACTIVE})),
    "stop": ("estop", frozenset({Mode.FAULT})),
}

#: Service that has the recorder write the last seconds.
RECORD = "record"

#: Number of cycles after which a command counts as dropped by a full queue of requests.
_LONGEST_WAIT = 1000


class CommandOutcomes:
    """Reports the outcome of each command that a service has sent to the loop."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: list[_Waiting] = []

    def ask(self, word: str, send: Callable[[], None], answer: Callable[[bool, str], None]) -> None:
        """Send a command; `answer` is called later with its success and a message."""
        with self._lock:
            self._waiting.append(_Waiting(word, answer))
            send()

    def observe(self, report: CycleReport) -> None:
        """Process the report of a cycle, on the loop's thread."""
        if not self._waiting:
            return
        with self._lock:
            self._waiting = [waiting for waiting in self._waiting if not waiting.observe(report)]

    def end(self, reason: str) -> None:
        """Answer all pending commands, as there are no more cycles."""
        with self._lock:
            ended, self._waiting = self._waiting, []
        for waiting in ended:
            waiting.answer(False, reason)


class _Waiting:
    """A pending command."""

    def __init__(self, word: str, answer: Callable[[bool, str], None]) -> None:
        self.answer = answer
        self._word = word
        self._cycles = 0
        self._taken = False  # whether a cycle has accepted the command

    def observe(self, report: CycleReport) -> bool:
        """Process the report of a cycle; return True if the command is answered."""
        self._cycles += 1
        if not self._taken:
            # It is read on another thread, which may take some cycles.
            if self._word not in report.inputs.requests.commands:
                if self._cycles < _LONGEST_WAIT:
                    return False
                self.answer(False, f"command {self._word!r} was not taken within {self._cycles} cycles; send it again")
                return True
            refusals = [text for text in report.refused if text.startswith(f"command {self._word!r}")]
            if refusals:
                self.answer(False, refusals[-1])
                return True
            self._taken = True
        if self._word == "deactivate" and report.mode in _IN_CONTROL:  # the torques ramp down
            return False
        state = report.mode.value
        if report.fault is not None:
            state += f" {report.fault.code}: {report.fault.sentence}"
        expected = next(modes for word, modes in SERVICES.values() if word == self._word)
        self.answer(report.mode in expected, state)
        return True
