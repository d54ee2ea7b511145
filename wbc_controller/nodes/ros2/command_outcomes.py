"""Outcomes of service commands."""

import threading
from collections.abc import Callable
from dataclasses import dataclass

from wbc_controller.controller.report import CycleReport
from wbc_controller.records import IN_CONTROL, Mode

#: By service, its command and the confirming modes.
SERVICES: dict[str, tuple[str, tuple[Mode, ...]]] = {
    "activate": ("activate", IN_CONTROL),
    "deactivate": ("deactivate", (Mode.INACTIVE,)),
    "reset": ("reset", (Mode.INACTIVE,)),
    "stop": ("estop", (Mode.FAULT,)),
}

RECORD = "record"  # service

_LONGEST_WAIT = 1000  # cycles; then the command counts as dropped


@dataclass(slots=True)
class _PendingCommand:
    word: str
    respond: Callable[[bool, str], None]
    cycles: int = 0  # since the command was sent
    accepted: bool = False  # by a cycle


class CommandOutcomes:
    """Pending service commands of the loop."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._pending: list[_PendingCommand] = []

    def submit(self, word: str, send: Callable[[], None], respond: Callable[[bool, str], None]) -> None:
        """Send a command; `respond` is called later with success and a message."""
        with self._lock:
            self._pending.append(_PendingCommand(word, respond))
            send()

    def observe(self, report: CycleReport) -> None:
        """Process the report of a cycle, on the loop's thread."""
        if not self._pending:
            return
        with self._lock:
            for command in list(self._pending):
                outcome = _outcome(command, report)
                if outcome is not None:
                    self._pending.remove(command)
                    command.respond(*outcome)

    def end(self, reason: str) -> None:
        """Respond to all pending commands after the last cycle."""
        with self._lock:
            ended, self._pending = self._pending, []
        for command in ended:
            command.respond(False, reason)


def _outcome(command: _PendingCommand, report: CycleReport) -> tuple[bool, str] | None:
    """Return success and message of a command after the report of a cycle; None while it is pending."""
    word = command.word
    command.cycles += 1
    if not command.accepted:
        if word not in report.inputs.requests.commands:  # decoding on another thread may take some cycles
            if command.cycles < _LONGEST_WAIT:
                return None
            return False, f"command {word!r} was dropped: not processed in {command.cycles} cycles; send it again"
        refusals = [text for text in report.refused if text.startswith(f"command {word!r}")]
        if refusals:
            return False, refusals[-1]
        command.accepted = True
    if word == "deactivate" and report.mode in IN_CONTROL:  # the torques ramp down
        return None
    state = report.mode.value
    if report.fault is not None:
        state += f" {report.fault.code}: {report.fault.sentence}"
    return report.mode in next(modes for each, modes in SERVICES.values() if each == word), state
