"""Ages by stamp: how old a message's content is, on a clock whose offset from ours is learned or known."""

from __future__ import annotations

import math
from collections.abc import Callable

#: A stamp further ahead of where its stream should be is refused, s: latency varies by less.
_AHEAD = 0.25
#: Stamps that contradict those before for this long are a new time, s on our clock.
_REBASE = 0.3
#: By how much the clock of the stamps may be slower than ours, as a share of our time: a simulator at half speed.
_SLOWER = 0.5
#: Most of the lag that one gap between messages may explain in this way, s. A process that was stopped sees such a gap.
_GAP = 0.025


class StampTracker:
    """Judges the stamps of one stream of messages, and tells the age of the newest.

    With the lag of a message, its arrival on our clock less its stamp, the smallest lag is the offset between the two
    clocks and the shortest latency. What a later message lags more, it waited on its way: in a queue of a process that
    was stopped, say. The offset may rise by `_SLOWER` of the time between arrivals, though never by more than stamps
    do, so that a clock that drifts, or a simulator that is slower than real time, is not mistaken for latency. What has
    waited together arrives at once and cannot raise it. A latency that is constant from the start cannot be told from
    an offset between two clocks. Where the clocks are synchronized the offset is known, and every
    latency counts; a stamp that is ahead of our clock by more than a tolerance is refused.

    A simulator's clock may stand still while stamps go on; `stood` tells how long.

    Stamps have to rise. One that does not, or that is far ahead, is refused; where they go on so for `_REBASE`, the
    stream has a new time.

    Attributes:
        stood: how far the stamps have gone on, those that were refused too, since our clock moved last, s.
    """

    def __init__(self, ahead: Callable[[], float] | None = None, tolerance: float = 0.0) -> None:
        """Make a tracker that has seen no message.

        Args:
            ahead: returns the time of the stamps' clock less ours, s; None where it has to be learned.
            tolerance: how far a stamp may be ahead of that clock, s.
        """
        self.stood = 0.0
        # Of the newest message, whether it was accepted or not.
        self._newest = 0
        self._came = -math.inf
        self._last_refused = False
        self._refused = 0.0  # by how much the stamps of refused messages went on since one was accepted, s
        self._ahead = ahead
        self._tolerance = tolerance
        self._stamp = 0  # of the newest message that was accepted, ns
        self._arrival = -math.inf
        self._offset = math.inf
        self._may_rise = 0.0  # by what the offset may still rise, s
        self._lag = 0.0
        self._contradicted = math.inf  # since when stamps are refused, on our clock

    def judge(self, stamp: int, arrival: float) -> str | None:
        """Take the stamp of a message; say why it is refused, where it is.

        Args:
            stamp: of the message, ns.
            arrival: s, on our clock.
        """
        if not stamp > 0:
            return "header.stamp is 0; a state without a time cannot be used"
        step = (stamp - self._newest) * 1.0e-9
        if arrival != self._came:
            self.stood = 0.0
        elif 0.0 < step <= _AHEAD:  # another step is a stamp that contradicts the others
            self.stood += step
        self._newest, self._came = stamp, arrival
        passed, rise = arrival - self._arrival, (stamp - self._stamp) * 1.0e-9
        if self._last_refused or self._ahead is not None or not (0.0 < rise <= _AHEAD + passed):
            reason = self._refusal(stamp, arrival)
            if reason is not None:
                if self._last_refused and 0.0 < step <= _AHEAD:
                    self._refused += step
                self._last_refused = True
                return reason
            self._last_refused = False
            self._refused = 0.0
        lag = arrival - stamp * 1.0e-9
        may_rise = self._may_rise + _SLOWER * passed
        if may_rise > _GAP:
            may_rise = _GAP
        if rise > may_rise:
            rise = may_rise
        elif rise < 0.0:
            rise = 0.0
        self._may_rise = may_rise - rise
        offset = self._offset + rise
        self._offset = offset if offset < lag else lag
        self._lag, self._stamp, self._arrival = lag, stamp, arrival
        return None

    def _refusal(self, stamp: int, arrival: float) -> str | None:
        """Why a stamp is refused; None where it is not, or where it begins a new time."""
        if self._ahead is not None:
            reason = self._too_early(stamp * 1.0e-9 - (arrival + self._ahead()))
            if reason is not None:
                return reason
        return self._contradiction(stamp, arrival) if self._arrival > -math.inf else None

    def _too_early(self, ahead: float) -> str | None:
        if ahead <= self._tolerance:
            return None
        return (
            f"header.stamp is {ahead:.3f} s ahead of this computer's clock (limit {1e3 * self._tolerance:.0f} "
            "ms, safety.clock_tolerance)"
        )

    def _contradiction(self, stamp: int, arrival: float) -> str | None:
        """Why a stamp contradicts those before; None where it does not, or where it begins a new time."""
        step = (stamp - self._stamp) * 1.0e-9
        ahead = step - (arrival - self._arrival)
        if step > 0.0 and (step <= _AHEAD + (arrival - self._arrival) or self._ahead is not None):
            self._contradicted = math.inf
            return None
        if arrival < self._contradicted:
            self._contradicted = arrival
        if arrival - self._contradicted >= _REBASE:
            self._offset = self._contradicted = math.inf
            return None
        if step == 0.0:
            return f"header.stamp stands still at {stamp * 1e-9:.3f} s"
        if step < 0.0:
            return f"header.stamp is {-step:.3f} s before that of the last message"
        return f"header.stamp is {ahead:.3f} s ahead of the messages before"

    def age(self, now: float) -> float:
        """Age of what the newest message says, s; infinite where none was accepted.

        It is at least what the stamps of messages that were refused have gone on since: our clock may be too slow.

        Args:
            now: s, on our clock.
        """
        if self._arrival == -math.inf:
            return math.inf
        if self._ahead is not None:
            age = now + self.stood + self._ahead() - self._stamp * 1.0e-9
        else:
            age = now - self._arrival + (self._lag - self._offset)
        return self._refused if self._refused > age else age

    def waited(self, now: float) -> float:
        """What of the age was before the arrival of the newest message, s; 0 where none was accepted.

        Args:
            now: s, on our clock.
        """
        return self.age(now) - (now - self._arrival) if self._arrival > -math.inf else 0.0
