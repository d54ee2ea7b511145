"""Clocks of the loop."""

from __future__ import annotations

import threading
import time
from typing import Protocol


class Clock(Protocol):
    """Monotonic clock for ages and durations. The default methods suit a free-running clock."""

    def now(self) -> float:
        """Return the time since a fixed instant, s."""
        ...

    def stamp(self) -> int:
        """Return the time for message headers, ns."""
        ...

    def clock_offset(self) -> float:
        """Return `stamp` minus `now`, s."""
        return 0.0

    def resolution(self) -> float:
        """Return the step of the clock, s: 0 for a continuous clock, infinite if still unknown."""
        return 0.0

    def refresh(self) -> None:
        """Read pending time messages after each state; errors raise `TransportError`."""
        return

    def clock_fault(self) -> str | None:
        """Return the reason why ages cannot be measured, or None; called once per cycle."""
        return None

    def wait(self, stop: threading.Event, seconds: float) -> None:
        """Wait for a duration on this clock, or for the event."""
        stop.wait(seconds)


class MonotonicClock(Clock):
    """The computer's monotonic clock; with `synchronized` it reports steps of the wall clock."""

    _STEP = 0.002  # smallest reported step, s: below the smallest useful `safety.clock_tolerance`
    _READ_TIME = 1.0e-4  # longest time between both readings, s; a preempted thread skips the comparison

    def __init__(self, *, synchronized: bool = False) -> None:
        self._synchronized = synchronized
        self._clock_offset = time.time_ns() * 1.0e-9 - time.monotonic()
        self._update_offset()

    def now(self) -> float:
        """Return the time since a fixed instant, s."""
        return time.monotonic()

    def stamp(self) -> int:
        """Return the wall time since the epoch, ns."""
        return time.time_ns()

    def clock_offset(self) -> float:
        """Return the wall time minus `now`, s, at the last `clock_fault`."""
        return self._clock_offset

    def clock_fault(self) -> str | None:
        """Report a step of the wall clock since the last call, if stamps are compared with it."""
        if not self._synchronized:
            return None
        step = self._update_offset()
        if abs(step) <= self._STEP:
            return None
        return f"this computer's clock was set {'forward' if step > 0.0 else 'back'} by {abs(step):.3f} s"

    def _update_offset(self) -> float:
        """Return the change of the offset, s, or 0 if the thread was preempted."""
        before, wall, after = time.monotonic(), time.time_ns(), time.monotonic()
        if after - before > self._READ_TIME:
            return 0.0
        old, self._clock_offset = self._clock_offset, wall * 1.0e-9 - 0.5 * (before + after)
        return self._clock_offset - old


class ManualClock(Clock):
    """Manually advanced clock for lockstep runs and tests; `wait` waits for wall time."""

    def __init__(self, time: float = 0.0) -> None:
        self.time = time  # s

    def now(self) -> float:
        """Return the present time, s."""
        return self.time

    def stamp(self) -> int:
        """Return the present time, ns."""
        return round(self.time * 1.0e9)
