"""Clocks of the loop: the machine's monotonic clock, and one that is set by hand."""

from __future__ import annotations

import threading
import time
from typing import Protocol


class Clock(Protocol):
    """Measures ages and durations; it never runs backwards. The methods below suit a clock that runs by itself."""

    def now(self) -> float:
        """Return the time since some fixed instant, s."""
        ...

    def stamp(self) -> int:
        """Return the time for message headers, ns."""
        ...

    def ahead(self) -> float:
        """Return the time of `stamp` minus that of `now`, s."""
        return 0.0

    def resolution(self) -> float:
        """Return the step between two times of the clock, s; 0 if it runs continuously, infinite if unknown yet."""
        return 0.0

    def refresh(self) -> None:
        """Read the time if it arrives by messages; called on the loop's thread, after it has taken a state.

        Raises:
            TransportError: if the topic of the clock cannot be read.
        """
        return

    def trouble(self) -> str | None:
        """Return why ages cannot be measured at this moment, None if they can; called once per cycle."""
        return None

    def wait(self, stop: threading.Event, seconds: float) -> None:
        """Wait for a duration on this clock, or until the event is set."""
        stop.wait(seconds)


class MonotonicClock(Clock):
    """The machine's monotonic clock.

    Args:
        synchronized: True if stamps are compared with the wall clock: `trouble` then reports that it was set.
    """

    #: Step of the wall clock that is reported, s: below the smallest useful `safety.clock_tolerance`.
    _STEP = 0.002
    #: Time within which both clocks must be read for a comparison, s: a thread may lose the processor in between.
    _AT_ONCE = 1.0e-4

    def __init__(self, *, synchronized: bool = False) -> None:
        self._synchronized = synchronized
        self._ahead = time.time_ns() * 1.0e-9 - time.monotonic()
        self._compare()

    def now(self) -> float:
        """Return the time since some fixed instant, s."""
        return time.monotonic()

    def stamp(self) -> int:
        """Return the wall time since the epoch, ns."""
        return time.time_ns()

    def ahead(self) -> float:
        """Return the wall time minus that of `now`, s, as of the last `trouble`."""
        return self._ahead

    def trouble(self) -> str | None:
        """Report that the wall clock was set since the last call, if stamps are compared with it."""
        if not self._synchronized:
            return None
        step = self._compare()
        if abs(step) <= self._STEP:
            return None
        return f"this computer's clock was set {'forward' if step > 0.0 else 'back'} by {abs(step):.3f} s"

    def _compare(self) -> float:
        """Read both clocks; return the change of their difference, s, or 0 if they could not be read at once."""
        before, wall, after = time.monotonic(), time.time_ns(), time.monotonic()
        if after - before > self._AT_ONCE:
            return 0.0
        old, self._ahead = self._ahead, wall * 1.0e-9 - 0.5 * (before + after)
        return self._ahead - old


class ManualClock(Clock):
    """A clock that is set by hand, for lockstep runs and tests; `wait` waits for wall time."""

    def __init__(self, time: float = 0.0) -> None:
        self.time = time  # the present time, s

    def now(self) -> float:
        """Return the present time, s."""
        return self.time

    def stamp(self) -> int:
        """Return the present time, ns."""
        return round(self.time * 1.0e9)
