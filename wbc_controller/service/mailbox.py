"""Mailboxes for streams of states: all that a transport's thread touches of them."""

from __future__ import annotations

import threading
from collections import deque

from wbc_controller.service.clock import Clock


class Mailbox:
    """Keeps the newest messages of one topic, with their times of arrival; newer ones replace those not taken."""

    def __init__(self, clock: Clock, arrived: threading.Event | None = None, *, depth: int = 1) -> None:
        """Make an empty mailbox.

        Args:
            clock: dates the messages.
            arrived: set on each message, for a loop that waits for it.
            depth: number of messages that it keeps.
        """
        self._clock = clock
        self._arrived = arrived
        self._lock = threading.Lock()
        self._newest: deque[tuple[float, bytes]] = deque(maxlen=depth)

    def put(self, payload: bytes) -> None:
        """Store a serialized message: the callback of a transport."""
        received = self._clock.now()
        with self._lock:
            self._newest.append((received, payload))
        if self._arrived is not None:
            self._arrived.set()

    def take(self) -> list[tuple[float, bytes]]:
        """Empty the mailbox: the newest messages with their times of arrival, s, in order."""
        with self._lock:
            newest = list(self._newest)
            self._newest.clear()
        return newest
