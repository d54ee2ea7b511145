"""Rate limit of log messages."""

import math
import time


class LogLimit:
    """At most one log message per second and topic."""

    _WARNING_PERIOD = 1.0  # s

    def __init__(self) -> None:
        self._passed: dict[str, float] = {}  # time of the last message, s, by topic

    def passes(self, topic: str) -> bool:
        """Return True once per second and topic."""
        now = time.monotonic()
        if now - self._passed.get(topic, -math.inf) < self._WARNING_PERIOD:
            return False
        self._passed[topic] = now
        return True
