"""One-slot mailboxes for streams, and bounded queues for requests: the only objects that a transport's thread uses."""

from __future__ import annotations

import threading
from collections import deque

from wbc_controller.service.clock import Clock


class Mailbox:
    """Keeps the newest messages of one topic, with the time each arrived.

    With a depth of 1 a newer message replaces an unread one. With a larger depth messages are queued in order; when the
    queue is full, new ones are rejected and counted, so that no message is lost silently.
    """

    def __init__(self, clock: Clock, depth: int, arrived: threading.Event | None = None) -> None:
        """Make a mailbox.

        Args:
            clock: gives each message its time of arrival.
            depth: largest number of messages kept.
            arrived: event set on each message, for a loop that waits for one.
        """
        self._clock = clock
        self._depth = depth
        self._arrived = arrived
        self._lock = threading.Lock()
        self._messages: deque[tuple[float, bytes]] = deque()
        self._turned_away = 0

    def put(self, payload: bytes) -> None:
        """Store a serialized message; called by the transport, on its own thread."""
        received = self._clock.now()
        with self._lock:
            if self._depth == 1:
                self._messages.clear()
            if len(self._messages) < self._depth:
                self._messages.append((received, payload))
            else:
                self._turned_away += 1
        if self._arrived is not None:
            self._arrived.set()

    def take(self) -> tuple[list[tuple[float, bytes]], int]:
        """Empty the mailbox.

        Returns:
            The messages in order of arrival, each with its time of arrival; and the number of rejected ones.
        """
        with self._lock:
            messages, self._messages = list(self._messages), deque()
            turned_away, self._turned_away = self._turned_away, 0
        return messages, turned_away
