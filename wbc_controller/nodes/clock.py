"""Clocks of the loop: the machine's monotonic clock, and one that is set by hand."""

from __future__ import annotations

import threading
import time
from typing import Protocol


class Clock(Protocol):
    """Measures ages and durations; it never runs backwards."""

    def refresh(self) -> None:
        """Read the time where it arrives by messages; called on the loop's thread, after it has taken a state.

        Raises:
            TransportError: if the topic of the clock cannot be read.
        """
        ...

    def resolution(self) -> float:
        """Step between two times that the clock shows, s; 0 if it runs continuously, or the step is unknown."""
        ...

    def now(self) -> float:
        """Time since some fixed instant, s."""
        ...

    def stamp(self) -> int:
        """Time for message headers, ns."""
        ...

    def ahead(self) -> float:
        """The time of `stamp` less that of `now`, s."""
        ...

    def trouble(self) -> str | None:
        """Why ages cannot be measured at this moment, None if they can; called once per cycle."""
        ...

    def wait(self, stop: threading.Event, seconds: float) -> None:
        """Wait for a duration on this clock, or until the event is set."""
        ...


class MonotonicClock:
    """The machine's monotonic clock.

    Args:
        synchronized: whether stamps are compared with the wall clock: then `trouble` says when that has been set.
    """

    #: Step of the wall clock that is said, s: below the smallest useful `safety.clock_tolerance`.
    _STEP = 0.002
    #: Time within which both clocks must be read for a comparison, s: a thread may lose the processor in between.
    _AT_ONCE = 1.0e-4

    def __init__(self, *, synchronized: bool = False) -> None:
        self._synchronized = synchronized
        self._ahead = time.time_ns() * 1.0e-9 - time.monotonic()
        self._compare()

    def refresh(self) -> None:
        """Do nothing: the clock is read whenever it is asked."""

    def resolution(self) -> float:
        """0, as it runs continuously."""
        return 0.0

    def now(self) -> float:
        """Time since some fixed instant, s."""
        return time.monotonic()

    def stamp(self) -> int:
        """Wall time since the epoch, ns."""
        return time.time_ns()

    def ahead(self) -> float:
        """Wall time less that of `now`, s, as it was at the last `trouble`."""
        return self._ahead

    def trouble(self) -> str | None:
        """Reports that the wall clock was set since the last call, where stamps are compared with it."""
        if not self._synchronized:
            return None
        step = self._compare()
        if abs(step) <= self._STEP:
            return None
        return f"this computer's clock was set {'forward' if step > 0.0 else 'back'} by {abs(step):.3f} s"

    def wait(self, stop: threading.Event, seconds: float) -> None:
        """Wait for a duration, or until the event is set."""
        stop.wait(seconds)

    def _compare(self) -> float:
        """Read both clocks; the change of their difference, s, or 0 where they could not be read at once."""
        before, wall, after = time.monotonic(), time.time_ns(), time.monotonic()
        if after - before > self._AT_ONCE:
            return 0.0
        old, self._ahead = self._ahead, wall * 1.0e-9 - 0.5 * (before + after)
        return self._ahead - old


class ManualClock:
    """A clock that stands still until it is set, for lockstep runs and tests.

    Attributes:
        time: the time shown, s.
    """

    def __init__(self, time: float = 0.0) -> None:
        self.time = time

    def refresh(self) -> None:
        """Do nothing: the time is set by hand."""

    def resolution(self) -> float:
        """0, as its steps are unknown."""
        return 0.0

    def now(self) -> float:
        """The time shown, s."""
        return self.time

    def stamp(self) -> int:
        """The time shown, ns."""
        return round(self.time * 1.0e9)

    def ahead(self) -> float:
        """0, as both times are the same."""
        return 0.0

    def trouble(self) -> str | None:
        """Return None, as no trouble is possible."""
        return None

    def wait(self, stop: threading.Event, seconds: float) -> None:
        """Wait for a duration of wall time, or until the event is set."""
        stop.wait(seconds)
