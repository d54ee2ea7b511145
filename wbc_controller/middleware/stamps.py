"""Ages by stamp: how old a message's content is, on a clock whose offset from ours is learned or known."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from wbc_controller.middleware.stamp_kernels import (
    AHEAD,
    ARRIVAL,
    LAST_REFUSED,
    OFFSET,
    REFUSED,
    STAMP,
    STEP,
    STOOD,
    accepted,
    age,
    judged,
    nothing,
)

#: Stamps that contradict those before for this long are a new time, s on our clock.
_REBASE = 0.3


class StampTracker:
    """Judges the stamps of one stream of messages, and tells the age of the newest.

    With the lag of a message, its arrival on our clock less its stamp, the smallest lag is the offset between the two
    clocks and the shortest latency. What a later message lags more, it waited on its way: in a queue of a process that
    was stopped, say. The offset may rise by half of the time between arrivals, though never by more than stamps
    do, so that a clock that drifts, or a simulator that is slower than real time, is not mistaken for latency. What has
    waited together arrives at once and cannot raise it. A latency that is constant from the start cannot be told from
    an offset between two clocks. Where the clocks are synchronized the offset is known, and every
    latency counts; a stamp that is ahead of our clock by more than a tolerance is refused.

    A simulator's clock may stand still while stamps go on; `stood` tells how long.

    Stamps have to rise. One that does not, or that is far ahead, is refused; where they go on so for `_REBASE`, the
    stream has a new time.

    Attributes:
        memory: what is remembered (`middleware.stamp_kernels`).
        tolerance: how far a stamp may be ahead of a clock that is known, s.
    """

    def __init__(self, ahead: Callable[[], float] | None = None, tolerance: float = 0.0) -> None:
        """Make a tracker that has seen no message.

        Args:
            ahead: returns the time of the stamps' clock less ours, s; None where it has to be learned.
            tolerance: how far a stamp may be ahead of that clock, s.
        """
        self.memory, self.tolerance = nothing(known=ahead is not None), tolerance
        self._times = self.memory.view(np.int64)
        self._ahead = ahead
        self._contradicted = math.inf  # since when stamps are refused, on our clock

    @property
    def stood(self) -> float:
        """How far the stamps have gone on, those that were refused too, since our clock moved last, s."""
        return float(self.memory[STOOD])

    def ahead(self) -> float:
        """The time of the stamps' clock less ours, s, where it is known; 0 where it is learned."""
        return 0.0 if self._ahead is None else self._ahead()

    def judge(self, stamp: int, arrival: float) -> str | None:
        """Take the stamp of a message; say why it is refused, where it is.

        Args:
            stamp: of the message, ns.
            arrival: s, on our clock.
        """
        if not stamp > 0:
            return "header.stamp is 0; a state without a time cannot be used"
        memory, ahead = self.memory, self.ahead()
        if judged(memory, stamp, arrival, ahead, self.tolerance):
            return None
        reason = self._refusal(stamp, arrival, ahead)
        if reason is None:
            accepted(memory, stamp, arrival)
            return None
        if memory[LAST_REFUSED] and 0.0 < memory[STEP] <= AHEAD:
            memory[REFUSED] += memory[STEP]
        memory[LAST_REFUSED] = 1.0
        return reason

    def _refusal(self, stamp: int, arrival: float, ahead: float) -> str | None:
        """Why a stamp is refused; None where it is not, or where it begins a new time."""
        early = stamp * 1.0e-9 - (arrival + ahead)
        if self._ahead is not None and not (early <= self.tolerance):
            return (
                f"header.stamp is {early:.3f} s ahead of this computer's clock (limit {1e3 * self.tolerance:.0f} "
                "ms, safety.clock_tolerance)"
            )
        before = float(self.memory[ARRIVAL])
        return self._contradiction(stamp, arrival, before) if before > -math.inf else None

    def _contradiction(self, stamp: int, arrival: float, before: float) -> str | None:
        """Why a stamp contradicts those before; None where it does not, or where it begins a new time."""
        last = int(self._times[STAMP])
        step = (stamp - last) * 1.0e-9
        ahead = step - (arrival - before)
        if step > 0.0 and (step <= AHEAD + (arrival - before) or self._ahead is not None):
            self._contradicted = math.inf
            return None
        if arrival < self._contradicted:
            self._contradicted = arrival
        if arrival - self._contradicted >= _REBASE:
            self.memory[OFFSET] = self._contradicted = math.inf
            return None
        if step == 0.0:
            return f"header.stamp stands still at {stamp * 1e-9:.3f} s"
        if step < 0.0:
            return f"header.stamp is {-step:.3f} s before that of the last message"
        return f"header.stamp is {ahead:.3f} s ahead of the messages before"

    def age(self, now: float) -> float:
        """Age of what the newest message says, s; infinite where none was accepted (`middleware.stamp_kernels.age`).

        Args:
            now: s, on our clock.
        """
        known: float = age(self.memory, now, self.ahead())
        return known

    def waited(self, now: float) -> float:
        """What of the age was before the arrival of the newest message, s; 0 where none was accepted.

        Args:
            now: s, on our clock.
        """
        arrival = float(self.memory[ARRIVAL])
        return self.age(now) - (now - arrival) if arrival > -math.inf else 0.0
