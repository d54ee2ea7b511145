"""Clocks of the loop: the machine's, and one that is set by hand."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Measures ages and durations; it never goes back."""

    def now(self) -> float:
        """Time since some fixed instant, s."""
        ...


class MonotonicClock:
    """The machine's monotonic clock."""

    def now(self) -> float:
        """Time since some fixed instant, s."""
        return time.monotonic()


class ManualClock:
    """A clock that stands still until it is set: for lockstep runs and tests.

    Attributes:
        time: what it shows, s.
    """

    def __init__(self, time: float = 0.0) -> None:
        self.time = time

    def now(self) -> float:
        """What it shows, s."""
        return self.time
