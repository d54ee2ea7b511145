"""Timestamps of messages: their validity, and the age of the newest message on the local clock."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

from wbc_controller.errors import InputRefused

#: Seconds and nanoseconds of a message's header, and their place after the encapsulation header, bytes.
_STAMP, _STAMP_AT = struct.Struct("<iI"), 4
#: Largest advance of a timestamp over the expected time of its stream, s: the latency varies by less.
_AHEAD = 0.25
#: Largest rate by which the sender's clock may be slower than the local clock: a simulator at half speed.
_SLOWER = 0.5
#: Largest lag that one gap between messages may explain by a slow clock, s. A process that was stopped sees such a gap.
_GAP = 0.025
#: Timestamps that contradict the accepted ones for this long start a new time, s on the local clock.
_REBASE = 0.3


def stamp_of(content: Any) -> int:
    """Return the time in a message's header, ns; errors as in `time_of`."""
    return time_of(content.header.stamp, "header.stamp")


def time_of(stamp: Any, what: str) -> int:
    """Return the time of a builtin_interfaces/Time, ns; `what` is its name in error messages.

    Raises:
        InputRefused: if the time is negative, or has a second or more of nanoseconds.
    """
    return _checked(stamp.sec, stamp.nanosec, what)


def header_stamp(payload: bytes) -> int:
    """Return the time in the header of a serialized message that starts with it, ns; errors as in `time_of`."""
    seconds, nanoseconds = _STAMP.unpack_from(payload, _STAMP_AT)
    return _checked(seconds, nanoseconds, "header.stamp")


def header_time(payload: bytes) -> float:
    """Return the time in the header of a serialized message that starts with it, s; errors as in `time_of`."""
    return 1.0e-9 * header_stamp(payload)


def _checked(seconds: int, nanoseconds: int, what: str) -> int:
    if not (seconds >= 0 and 0 <= nanoseconds < 1_000_000_000):
        raise InputRefused(
            f"{what} has sec = {seconds}, nanosec = {nanoseconds}; sec is not negative, nanosec is below 1e9"
        )
    return seconds * 1_000_000_000 + nanoseconds


class StampTracker:
    """Accepts or refuses the timestamps of one stream of messages, and measures the age of the newest message.

    The lag of a message is its arrival on the local clock less its timestamp. The smallest lag is the offset between
    the two clocks plus the shortest latency. A larger lag of a later message is time that it waited on its way, for
    example in a queue of a stopped process. The offset may rise by half of the time between arrivals, but never by more
    than the timestamps do. So a clock that drifts, or a simulator slower than real time, is not mistaken for latency.
    Messages that waited together arrive at once and cannot raise the offset. A latency that is constant from the start
    cannot be told from an offset between two clocks. If the clocks are synchronized, the offset is known: every latency
    counts, and a timestamp ahead of the local clock by more than a tolerance is refused.

    Timestamps have to rise. A timestamp that does not rise, or that is far ahead, is refused. If such timestamps
    continue for `_REBASE`, the stream has a new time.

    Attributes:
        clock_stall: advance of the timestamps, including refused ones, during a stall of the local clock, s. The clock
            of a simulator can stall while timestamps advance.

    Args:
        ahead: returns the time of the sender's clock less the local time, s; None if the offset has to be learned.
        tolerance: largest time by which a timestamp may be ahead of a known clock, s.
    """

    def __init__(self, ahead: Callable[[], float] | None = None, tolerance: float = 0.0) -> None:
        self._ahead, self._tolerance = ahead, tolerance
        self.clock_stall = 0.0
        self._newest_stamp, self._newest_arrival = 0, -math.inf  # of the newest message, accepted or refused
        self._stamp, self._arrival = 0, -math.inf  # of the newest accepted message, ns and s
        self._lag, self._offset = 0.0, math.inf  # lag of that message, and the smallest lag, s
        self._may_rise = 0.0  # by which the offset may still rise, s
        self._refused_advance = 0.0  # of the timestamps of refused messages since the last accepted one, s
        self._last_refused = False
        self._contradicted_since = math.inf  # on the local clock, s

    def judge(self, stamp: int, arrival: float) -> str | None:
        """Process the timestamp of a message; return the reason if it is refused, otherwise None.

        Args:
            stamp: of the message, ns.
            arrival: s, on the local clock.
        """
        if not stamp > 0:
            return "header.stamp is 0; a state without a time cannot be used"
        step = (stamp - self._newest_stamp) * 1.0e-9
        plausible = 0.0 < step <= _AHEAD  # otherwise it contradicts the other timestamps
        if arrival != self._newest_arrival:
            self.clock_stall = 0.0
        elif plausible:
            self.clock_stall += step
        self._newest_stamp, self._newest_arrival = stamp, arrival
        reason = self._too_early(stamp, arrival) or self._contradiction(stamp, arrival)
        if reason is None:
            self._accept(stamp, arrival)
        elif self._last_refused and plausible:
            self._refused_advance += step
        self._last_refused = reason is not None
        return reason

    def _too_early(self, stamp: int, arrival: float) -> str | None:
        """Return the reason if a timestamp is ahead of a known clock."""
        if self._ahead is None:
            return None
        early = stamp * 1.0e-9 - (arrival + self._ahead())
        if early <= self._tolerance:
            return None
        return (
            f"header.stamp is {early:.3f} s ahead of this computer's clock (limit {1e3 * self._tolerance:.0f} "
            "ms, safety.clock_tolerance)"
        )

    def _contradiction(self, stamp: int, arrival: float) -> str | None:
        """Return the reason if a timestamp contradicts the accepted ones and does not start a new time."""
        if self._arrival == -math.inf:
            return None
        step, passed = (stamp - self._stamp) * 1.0e-9, arrival - self._arrival
        if step > 0.0 and (self._ahead is not None or step <= _AHEAD + passed):
            self._contradicted_since = math.inf
            return None
        self._contradicted_since = min(self._contradicted_since, arrival)
        if arrival - self._contradicted_since >= _REBASE:
            self._offset = self._contradicted_since = math.inf
            return None
        if step == 0.0:
            return f"header.stamp stands still at {stamp * 1e-9:.3f} s"
        if step < 0.0:
            return f"header.stamp is {-step:.3f} s before that of the last message"
        return f"header.stamp is {step - passed:.3f} s ahead of the messages before"

    def _accept(self, stamp: int, arrival: float) -> None:
        """Update the offset between the clocks."""
        self._may_rise = min(self._may_rise + _SLOWER * (arrival - self._arrival), _GAP)
        rise = min(max((stamp - self._stamp) * 1.0e-9, 0.0), self._may_rise)
        self._may_rise -= rise
        self._lag = arrival - stamp * 1.0e-9
        self._offset = min(self._offset + rise, self._lag)
        self._stamp, self._arrival, self._refused_advance = stamp, arrival, 0.0

    def age(self, now: float) -> float:
        """Return the age of the content of the newest message, s; infinite before the first accepted message.

        It is at least the advance of the timestamps of refused messages, because the local clock may be too slow.

        Args:
            now: s, on the local clock.
        """
        if self._arrival == -math.inf:
            return math.inf
        if self._ahead is not None:
            age = now + self.clock_stall + self._ahead() - self._stamp * 1.0e-9
        else:
            age = now - self._arrival + (self._lag - self._offset)
        return self._refused_advance if self._refused_advance > age else age  # NaN stays NaN

    def waited(self, now: float) -> float:
        """Return the part of the age before the arrival of the newest message, s; 0 before the first accepted message.

        Args:
            now: s, on the local clock.
        """
        return self.age(now) - (now - self._arrival) if self._arrival > -math.inf else 0.0
