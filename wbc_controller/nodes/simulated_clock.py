"""A simulator's clock, which the control loop reads from its topic."""

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

#: Messages that wait for the loop; in a flood newer ones replace the oldest, so that reading them stays short.
_DEPTH = 10


class SimulatedClock:
    """A simulator's clock: it shows the newest time on the clock topic, and stands still between two messages.

    The loop's thread reads the topic itself. A simulator sends the time before the state of that time, so a loop that
    takes a state and then calls `refresh` has the time of that state, however busy the machine is. If the middleware
    delivers the time later than the state, the loop measures the delay in the stamps of the states.

    When the simulated time jumps back, as on a restart, this clock continues from its last time and reports the jump
    once, in `trouble`.

    Args:
        stream: messages of the clock topic, at most `_DEPTH` of them.
    """

    #: Longest wall time between two checks of whether `wait` is to end, s.
    _LOOK = 0.05
    #: Number of steps whose smallest is the resolution: longer ones contain messages that were dropped.
    _STEPS = 3
    #: Wall time for which the refusal of another message is not logged, s.
    _SILENCE = 1.0

    def __init__(self, stream: Stream, topic: Endpoint) -> None:
        self._stream, self._topic = stream, topic
        self._stamp: int | None = None
        self._gone_back = 0  # sum of all jumps back, ns
        self._now = 0.0  # one attribute, which other threads may read at any time
        self._steps: deque[int] = deque(maxlen=self._STEPS)  # the newest, ns
        self._trouble: str | None = None
        self._refused_at = -math.inf  # on the monotonic clock, s

    def refresh(self) -> None:
        """Read the messages that have arrived; for one thread only.

        Raises:
            TransportError: if the topic of the clock cannot be read.
        """
        for payload in self._stream.take():
            try:
                self._show(time_of(decode(payload, self._topic.type).clock, "clock"))
            except InputRefused as refusal:
                if time.monotonic() - self._refused_at >= self._SILENCE:
                    self._refused_at = time.monotonic()
                    _log.warning("%s: refused: %s", self._topic.name, refusal)

    def _show(self, stamp: int) -> None:
        """Show a time of the simulator, ns."""
        step = stamp - self._stamp if self._stamp is not None else 0
        if step > 0:
            self._steps.append(step)
        elif step < 0:
            self._gone_back -= step
            self._trouble = f"the simulated time went back from {(stamp - step) * 1e-9:.3f} to {stamp * 1e-9:.3f} s"
        self._stamp = stamp
        self._now = (stamp + self._gone_back) * 1.0e-9

    def resolution(self) -> float:
        """Smallest of the newest steps of the clock, s; infinite before the second time."""
        return min(self._steps, default=math.inf) * 1.0e-9

    def now(self) -> float:
        """Time since some fixed instant, s; 0 before the first message."""
        return self._now

    def stamp(self) -> int:
        """The simulator's time, ns; 0 before the first message."""
        return self._stamp or 0

    def ahead(self) -> float:
        """The simulator's time less that of `now`, s: not zero once the former has gone back."""
        return -self._gone_back * 1.0e-9

    def trouble(self) -> str | None:
        """Reports that no time has arrived yet, or that it has jumped back since the last call; None otherwise."""
        if self._stamp is None:
            return f"use_sim_time is set, and no time has arrived on {self._topic.name}"
        trouble, self._trouble = self._trouble, None
        return trouble

    def wait(self, stop: threading.Event, seconds: float) -> None:
        """Wait for a duration of simulated time, or until the event is set.

        Raises:
            TransportError: if the topic of the clock cannot be read.
        """
        end = self.now() + seconds
        while not stop.is_set() and self.now() < end:
            self._stream.wait(self._LOOK)
            self.refresh()


def clock_of(topics: Iterable[Endpoint], transport: Transport) -> SimulatedClock:
    """Make a clock that follows the simulated time on the clock topic.

    Args:
        transport: carries the messages; it delivers clock messages in every mode and lifecycle state of the node.

    Raises:
        TransportError: if the topic cannot be opened.
    """
    (endpoint,) = [topic for topic in topics if topic.key == "clock"]
    return SimulatedClock(transport.stream(endpoint, _DEPTH), endpoint)
