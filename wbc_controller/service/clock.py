"""Clocks of the loop: the machine's, that of a simulator, and one that is set by hand."""

from __future__ import annotations

import threading
import time
from typing import Protocol


class Clock(Protocol):
    """Measures ages and durations; it never goes back."""

    def now(self) -> float:
        """Time since some fixed instant, s."""
        ...

    def stamp(self) -> int:
        """Time for the headers of messages, ns."""
        ...

    def trouble(self) -> str | None:
        """Why no age can be told at this moment, where that is so; asked once per cycle."""
        ...

    def wait(self, stop: threading.Event, seconds: float) -> None:
        """Let time pass on this clock, or until the event is set."""
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
        """None: it always runs."""
        return None

    def wait(self, stop: threading.Event, seconds: float) -> None:
        """Let time pass, or until the event is set."""
        stop.wait(seconds)


class SimulatedClock:
    """A simulator's clock: it shows what the messages on the topic of the clock say, and stands still between them.

    Where the simulator begins anew, this clock goes on from where it was, and tells its trouble once.
    """

    #: Longest wall time before it is looked whether the waiting is to end, s.
    _LOOK = 0.05

    def __init__(self) -> None:
        self._moved = threading.Condition()
        self._stamp: int | None = None
        self._gone_back = 0  # sum of all steps back, ns
        self._trouble: str | None = None

    def set(self, stamp: int) -> None:
        """Take a simulator's time, ns; on any thread."""
        with self._moved:
            if self._stamp is not None and stamp < self._stamp:
                self._gone_back += self._stamp - stamp
                self._trouble = f"the simulated time went back from {self._stamp * 1e-9:.3f} to {stamp * 1e-9:.3f} s"
            self._stamp = stamp
            self._moved.notify_all()

    def now(self) -> float:
        """Time since some fixed instant, s; 0 until there is any."""
        with self._moved:
            return 0.0 if self._stamp is None else (self._stamp + self._gone_back) * 1.0e-9

    def stamp(self) -> int:
        """The simulator's time, ns; 0 until there is any."""
        return self._stamp or 0

    def trouble(self) -> str | None:
        """That no time has come yet, or that it has gone back since this was asked last."""
        with self._moved:
            if self._stamp is None:
                return "use_sim_time is set, and no time has come on the topic of the clock"
            trouble, self._trouble = self._trouble, None
            return trouble

    def wait(self, stop: threading.Event, seconds: float) -> None:
        """Let simulated time pass, or until the event is set."""
        end = self.now() + seconds
        while not stop.is_set() and self.now() < end:
            with self._moved:
                self._moved.wait(self._LOOK)


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

    def stamp(self) -> int:
        """What it shows, ns."""
        return round(self.time * 1.0e9)

    def trouble(self) -> str | None:
        """None."""
        return None

    def wait(self, stop: threading.Event, seconds: float) -> None:
        """Let wall time pass, or until the event is set."""
        stop.wait(seconds)
