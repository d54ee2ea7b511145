"""One-slot mailboxes for streams, and bounded queues for requests: all that a transport's thread touches."""

from __future__ import annotations

import threading
from collections import deque

from wbc_controller.service.clock import Clock


class Mailbox:
    """Keeps the newest messages of one topic, with the time each arrived.

    With a depth of 1 a newer message replaces the one that has not been read. With more, requests are kept in order,
    and when the queue is full the newest is turned away and counted: nothing is lost silently.
    """

    def __init__(self, clock: Clock, depth: int, arrived: threading.Event | None = None) -> None:
        """Make a mailbox.

        Args:
            clock: dates the messages.
            depth: number of messages kept.
            arrived: set on each message, for a loop that waits for it.
        """
        self._clock = clock
        self._depth = depth
        self._arrived = arrived
        self._lock = threading.Lock()
        self._messages: deque[tuple[float, bytes]] = deque()
        self._turned_away = 0

    def put(self, payload: bytes) -> None:
        """Take a serialized message: the callback of a transport."""
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
        """Empty the box.

        Returns:
            The messages in order of arrival, each with the time it arrived; and how many were turned away.
        """
        with self._lock:
            messages, self._messages = list(self._messages), deque()
            turned_away, self._turned_away = self._turned_away, 0
        return messages, turned_away
