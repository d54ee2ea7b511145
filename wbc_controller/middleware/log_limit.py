"""A limit for log messages about incoming messages: publishers decide how many of those there are."""

import math
import time


class LogLimit:
    """Lets through one message per second and topic."""

    _SILENCE = 1.0  # s

    def __init__(self) -> None:
        self._passed: dict[str, float] = {}  # time of the last message, s, by topic

    def passes(self, topic: str) -> bool:
        """Return True if no message about this topic has passed within the last second."""
        now = time.monotonic()
        if now - self._passed.get(topic, -math.inf) < self._SILENCE:
            return False
        self._passed[topic] = now
        return True
