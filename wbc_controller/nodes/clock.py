"""Clocks of the loop."""

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Iterable
from typing import Protocol

from wbc_controller.errors import InputRefused
from wbc_controller.middleware.codec import decode
from wbc_controller.middleware.log_limit import LogLimit
from wbc_controller.middleware.stamps import time_of
from wbc_controller.middleware.topics import Endpoint
from wbc_controller.middleware.transports.transport import Transport

_log = logging.getLogger(__name__)

_DEPTH = 10  # of the queue of times, limits the reading time in a flood


class Clock(Protocol):
    """Monotonic clock for ages and durations. The default methods suit a free-running clock."""

    def now(self) -> float:
        """Return the time since a fixed instant, s."""

    def stamp(self) -> int:
        """Return the time for message headers, ns."""

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


class SimulatedClock:
    """The newest time on the clock topic, constant between two messages.

    The loop calls `refresh` after it has taken a state, as a simulator publishes the time before the state. After a
    jump back the clock continues from its last time, and reports the jump once.
    """

    _CHECK_PERIOD = 0.05  # in `wait`, s wall time
    _STEPS = 3  # the resolution is their minimum: dropped messages lengthen steps

    def __init__(self, topics: Iterable[Endpoint], transport: Transport) -> None:
        """Subscribe to the clock topic, on a transport without lifecycle gate."""
        (self._topic,) = [topic for topic in topics if topic.key == "clock"]
        self._stream = transport.stream(self._topic, _DEPTH)
        self._stamp: int | None = None
        self._jumped_back = 0  # sum of all jumps back, ns
        self._now = 0.0  # read by any thread
        self._steps: deque[int] = deque(maxlen=self._STEPS)  # the newest, ns
        self._clock_fault: str | None = None
        self._limit = LogLimit()

    def refresh(self) -> None:
        """Read the pending messages, on the loop's thread only."""
        for payload in self._stream.take():
            try:
                self._set_time(time_of(decode(payload, self._topic.type).clock, "clock"))
            except InputRefused as refusal:
                if self._limit.passes(self._topic.name):
                    _log.warning("%s: refused: %s", self._topic.name, refusal)

    def _set_time(self, stamp: int) -> None:
        step = stamp - self._stamp if self._stamp is not None else 0
        if step > 0:
            self._steps.append(step)
        elif step < 0:
            self._jumped_back -= step
            self._clock_fault = f"the simulated time went back from {(stamp - step) * 1e-9:.3f} to {stamp * 1e-9:.3f} s"
        self._stamp = stamp
        self._now = (stamp + self._jumped_back) * 1.0e-9

    def resolution(self) -> float:
        """Return the smallest of the newest steps, s; infinite before the second time."""
        return min(self._steps, default=math.inf) * 1.0e-9

    def now(self) -> float:
        """Return the time since a fixed instant, s; 0 before the first message."""
        return self._now

    def stamp(self) -> int:
        """Return the simulated time, ns; 0 before the first message."""
        return self._stamp or 0

    def clock_offset(self) -> float:
        """Return the simulated time minus `now`, s: nonzero after a jump back."""
        return -self._jumped_back * 1.0e-9

    def clock_fault(self) -> str | None:
        """Return a message if no time has arrived yet, or after a jump back since the last call; None otherwise."""
        if self._stamp is None:
            return f"use_sim_time is set, but no time was received on {self._topic.name}"
        clock_fault, self._clock_fault = self._clock_fault, None
        return clock_fault

    def wait(self, stop: threading.Event, seconds: float) -> None:
        """Wait for a duration of simulated time, or for the event."""
        end = self.now() + seconds
        while not stop.is_set() and self.now() < end:
            self._stream.wait(self._CHECK_PERIOD)
            self.refresh()
