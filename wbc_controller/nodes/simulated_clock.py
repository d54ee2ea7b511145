"""Simulated time from the clock topic."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Iterable

from wbc_controller.errors import InputRefused
from wbc_controller.middleware.codec import decode
from wbc_controller.middleware.stamps import time_of
from wbc_controller.middleware.topics import Endpoint
from wbc_controller.middleware.transports.transport import Stream, Transport

_log = logging.getLogger(__name__)

_DEPTH = 10  # of the queue, limits the reading time in a flood


class SimulatedClock:
    """The newest time on the clock topic, constant between two messages.

    The loop calls `refresh` after it has taken a state, as a simulator publishes the time before the state. After a
    jump back the clock continues from its last time, and reports the jump once.
    """

    _CHECK_PERIOD = 0.05  # in `wait`, s wall time
    _STEPS = 3  # the resolution is their minimum: dropped messages lengthen steps
    _WARNING_PERIOD = 1.0  # of refusals, s wall time

    def __init__(self, stream: Stream, topic: Endpoint) -> None:
        self._stream, self._topic = stream, topic
        self._stamp: int | None = None
        self._jumped_back = 0  # sum of all jumps back, ns
        self._now = 0.0  # read by any thread
        self._steps: deque[int] = deque(maxlen=self._STEPS)  # the newest, ns
        self._clock_fault: str | None = None
        self._refused_at = -math.inf  # on the monotonic clock, s

    def refresh(self) -> None:
        """Read the pending messages, on the loop's thread only."""
        for payload in self._stream.take():
            try:
                self._set_time(time_of(decode(payload, self._topic.type).clock, "clock"))
            except InputRefused as refusal:
                if time.monotonic() - self._refused_at >= self._WARNING_PERIOD:
                    self._refused_at = time.monotonic()
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


def make_simulated_clock(topics: Iterable[Endpoint], transport: Transport) -> SimulatedClock:
    """Make the clock of the clock topic, on a transport without lifecycle gate."""
    (endpoint,) = [topic for topic in topics if topic.key == "clock"]
    return SimulatedClock(transport.stream(endpoint, _DEPTH), endpoint)
