"""Clocks of the loop: the machine's monotonic clock, a simulator's clock, and one that is set by hand."""

from __future__ import annotations

import threading
import time
from typing import Protocol


class Clock(Protocol):
    """Measures ages and durations; it never runs backwards."""

    def now(self) -> float:
        """Time since some fixed instant, s."""
        ...

    def stamp(self) -> int:
        """Time for message headers, ns."""
        ...

    def trouble(self) -> str | None:
        """Why ages cannot be measured at this moment, None if they can; called once per cycle."""
        ...

    def wait(self, stop: threading.Event, seconds: float) -> None:
        """Wait for a duration on this clock, or until the event is set."""
        ...


class MonotonicClock:
    """The machine's monotonic clock."""

    def now(self) -> float:
        """Time since some fixed instant, s."""
        return time.monotonic()

    def stamp(self) -> int:
        """Wall time since the epoch, ns."""
        return time.time_ns()

    def trouble(self) -> str | None:
        """Return None, as this clock always runs."""
        return None

    def wait(self, stop: threading.Event, seconds: float) -> None:
        """Wait for a duration, or until the event is set."""
        stop.wait(seconds)


class SimulatedClock:
    """A simulator's clock: it shows the time of the last message on the clock topic, and stands still in between.

    When the simulated time jumps back, as on a restart, this clock continues from its last time and reports the jump
    once, in `trouble`.
    """

    #: Longest wall time between two checks of whether `wait` is to end, s.
    _LOOK = 0.05

    def __init__(self) -> None:
        self._moved = threading.Condition()
        self._stamp: int | None = None
        self._gone_back = 0  # sum of all jumps back, ns
        self._trouble: str | None = None

    def set(self, stamp: int) -> None:
        """Set the simulator's time, ns; may be called on any thread."""
        with self._moved:
            if self._stamp is not None and stamp < self._stamp:
                self._gone_back += self._stamp - stamp
                self._trouble = f"the simulated time went back from {self._stamp * 1e-9:.3f} to {stamp * 1e-9:.3f} s"
            self._stamp = stamp
            self._moved.notify_all()

    def now(self) -> float:
        """Time since some fixed instant, s; 0 before the first message."""
        with self._moved:
            return 0.0 if self._stamp is None else (self._stamp + self._gone_back) * 1.0e-9

    def stamp(self) -> int:
        """The simulator's time, ns; 0 before the first message."""
        return self._stamp or 0

    def trouble(self) -> str | None:
        """Reports that no time has arrived yet, or that it has jumped back since the last call; None otherwise."""
        with self._moved:
            if self._stamp is None:
                return "use_sim_time is set, and no time has come on the topic of the clock"
            trouble, self._trouble = self._trouble, None
            return trouble

    def wait(self, stop: threading.Event, seconds: float) -> None:
        """Wait for a duration of simulated time, or until the event is set."""
        end = self.now() + seconds
        while not stop.is_set() and self.now() < end:
            with self._moved:
                self._moved.wait(self._LOOK)


class ManualClock:
    """A clock that stands still until it is set, for lockstep runs and tests.

    Attributes:
        time: the time shown, s.
    """

    def __init__(self, time: float = 0.0) -> None:
        self.time = time

    def now(self) -> float:
        """The time shown, s."""
        return self.time

    def stamp(self) -> int:
        """The time shown, ns."""
        return round(self.time * 1.0e9)

    def trouble(self) -> str | None:
        """Return None, as no trouble is possible."""
        return None

    def wait(self, stop: threading.Event, seconds: float) -> None:
        """Wait for a duration of wall time, or until the event is set."""
        stop.wait(seconds)
