"""Passes serialized messages from the transport's threads to the mock robot's thread."""

from __future__ import annotations

import threading
from collections import deque


class Inbox:
    """The answers and requests that wait."""

    def __init__(self) -> None:
        self._arrived = threading.Condition()
        # Bounded, because they are not emptied while the robot waits.
        self._answers: deque[bytes] = deque(maxlen=10)
        self._requests: deque[tuple[str, str, bytes]] = deque(maxlen=100)

    def put_answer(self, payload: bytes) -> None:
        """Store a command of lockstep."""
        with self._arrived:
            self._answers.append(payload)
            self._arrived.notify()

    def put_request(self, key: str, subject: str, payload: bytes) -> None:
        """Store a request, with its row of the topic table and its subject."""
        with self._arrived:
            self._requests.append((key, subject, payload))

    def take_answers(self) -> list[bytes]:
        """Take all commands of lockstep, in order of arrival."""
        with self._arrived:
            payloads = list(self._answers)
            self._answers.clear()
            return payloads

    def take_requests(self) -> list[tuple[str, str, bytes]]:
        """Take all requests, in order of arrival."""
        with self._arrived:
            requests = list(self._requests)
            self._requests.clear()
            return requests

    def wait_for_answer(self, timeout: float) -> None:
        """Wait until a command has arrived, at most `timeout` seconds."""
        with self._arrived:
            self._arrived.wait_for(lambda: bool(self._answers), timeout)
