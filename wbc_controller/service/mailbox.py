"""One-slot mailboxes for streams of states: all that a transport's thread touches of them."""

from __future__ import annotations

import threading

from wbc_controller.service.clock import Clock


class Mailbox:
    """Keeps the newest message of one topic, with its time of arrival; a newer one replaces one that was not taken."""

    def __init__(self, clock: Clock, arrived: threading.Event | None = None) -> None:
        """Make an empty mailbox.

        Args:
            clock: dates the messages.
            arrived: set on each message, for a loop that waits for it.
        """
        self._clock = clock
        self._arrived = arrived
        self._lock = threading.Lock()
        self._newest: tuple[float, bytes] | None = None

    def put(self, payload: bytes) -> None:
        """Store a serialized message: the callback of a transport."""
        received = self._clock.now()
        with self._lock:
            self._newest = received, payload
        if self._arrived is not None:
            self._arrived.set()

    def take(self) -> tuple[float, bytes] | None:
        """Empty the mailbox: the newest message with its time of arrival, s; None where none has come since."""
        with self._lock:
            newest, self._newest = self._newest, None
        return newest
