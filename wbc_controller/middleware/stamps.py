"""Timestamps: validity, and age on the local clock."""

import math
import struct
from collections.abc import Callable
from typing import Any

from wbc_controller.errors import InputRefused

_STAMP, _STAMP_AT = struct.Struct("<iI"), 4  # seconds and nanoseconds, and their offset in a message
_MAX_ADVANCE = 0.25  # over the expected time, s: above changes of the latency
_MAX_LEAD = 0.03  # of a single timestamp over the expected time, s: above `_GAP`
_CONFIRMATION = 0.01  # advance of the timestamps until a larger lead is a shorter latency, s
_MAX_CLOCK_SLOWDOWN = 0.5  # such as a simulator at half speed
_GAP = 0.025  # largest lag by a slow clock after one gap, s
_REBASE = 0.3  # duration of contradictions before a new time, s on the local clock


def stamp_of(content: Any) -> int:
    """Return the time of a message's header, ns; errors as for `time_of`."""
    return time_of(content.header.stamp, "header.stamp")


def time_of(stamp: Any, what: str) -> int:
    """Return a builtin_interfaces/Time in ns; raises `InputRefused`, naming `what`, if invalid."""
    return _checked(stamp.sec, stamp.nanosec, what)


def header_stamp(payload: bytes) -> int:
    """Return the time of a serialized message's header, ns; errors as for `time_of`."""
    seconds, nanoseconds = _STAMP.unpack_from(payload, _STAMP_AT)
    return _checked(seconds, nanoseconds, "header.stamp")


def header_time(payload: bytes) -> float:
    """Return the same in s."""
    return 1.0e-9 * header_stamp(payload)


def _checked(seconds: int, nanoseconds: int, what: str) -> int:
    if not (seconds >= 0 and 0 <= nanoseconds < 1_000_000_000):
        raise InputRefused(f"{what} has sec = {seconds}, nanosec = {nanoseconds}; valid: sec from 0, nanosec below 1e9")
    return seconds * 1_000_000_000 + nanoseconds


class StampTracker:
    """Check of one stream's timestamps, and age of its newest message.

    - Lag: arrival on the local clock minus timestamp. The smallest lag is the clock offset plus the shortest latency;
      the excess is transit time.
    - The offset rises at most by half of the time between arrivals and by the advance of the timestamps: a drifting
      clock or a slow simulator is not latency.
    - With synchronized clocks the offset is known; timestamps ahead by more than the tolerance are refused.
    - Timestamps must increase. A lead above `_MAX_LEAD` is refused until the successors confirm it for `_CONFIRMATION`,
      as is a shorter latency. Others, and leads above `_MAX_ADVANCE`, count after `_REBASE` as a new time.

    `clock_offset` returns sender's minus local clock, s; None to estimate it. `tolerance` is the largest lead of a
    timestamp over a known clock, s.
    """

    def __init__(self, clock_offset: Callable[[], float] | None = None, tolerance: float = 0.0) -> None:
        self._clock_offset, self._tolerance = clock_offset, tolerance
        #: Advance of the timestamps, including refused ones, during a stall of the local clock, s.
        self.clock_stall = 0.0
        self._newest_stamp, self._newest_arrival = 0, -math.inf  # of the newest message, accepted or refused
        self._stamp, self._arrival = 0, -math.inf  # of the newest accepted message, ns and s
        self._lag, self._offset = 0.0, math.inf  # of that message, and smallest lag, s
        self._may_rise = 0.0  # remaining rise of the offset, s
        self._refused_advance = 0.0  # advance of refused timestamps since the last accepted one, s
        self._last_refused = False
        self._contradicted_since = math.inf  # on the local clock, s
        self._new_time = False  # True if the last timestamp begins a new time

    def refusal(self, stamp: int, arrival: float) -> str | None:
        """Return the reason to refuse a timestamp, ns, with its local arrival, s; None before `accept`."""
        if not stamp > 0:
            return "header.stamp is 0; it must be the time of the measurement"
        step = (stamp - self._newest_stamp) * 1.0e-9
        plausible = 0.0 < step <= _MAX_ADVANCE  # otherwise contradictory
        if arrival != self._newest_arrival:
            self.clock_stall = 0.0
        elif plausible:
            self.clock_stall += step
        self._newest_stamp, self._newest_arrival = stamp, arrival
        self._new_time = False
        refused_advance = self._refused_advance + (step if self._last_refused and plausible else 0.0)
        reason = self._too_early(stamp, arrival) or self._contradiction(stamp, arrival, refused_advance)
        self._last_refused = reason is not None
        if reason is not None:
            self._refused_advance = refused_advance
        return reason

    def accept(self, stamp: int, arrival: float) -> None:
        """Store a timestamp without `refusal`."""
        if self._new_time:
            self._offset = math.inf
        self._contradicted_since = math.inf
        self._may_rise = min(self._may_rise + _MAX_CLOCK_SLOWDOWN * (arrival - self._arrival), _GAP)
        rise = min(max((stamp - self._stamp) * 1.0e-9, 0.0), self._may_rise)
        self._may_rise -= rise
        self._lag = arrival - stamp * 1.0e-9
        self._offset = min(self._offset + rise, self._lag)
        self._stamp, self._arrival, self._refused_advance = stamp, arrival, 0.0

    def _too_early(self, stamp: int, arrival: float) -> str | None:
        if self._clock_offset is None:
            return None
        early = stamp * 1.0e-9 - (arrival + self._clock_offset())
        if early <= self._tolerance:
            return None
        return (
            f"header.stamp is {early:.3f} s ahead of the local clock (limit {1e3 * self._tolerance:.0f} ms, "
            "safety.clock_tolerance)"
        )

    def _contradiction(self, stamp: int, arrival: float, refused_advance: float) -> str | None:
        if self._arrival == -math.inf:
            return None
        step = (stamp - self._stamp) * 1.0e-9
        lead = self._offset - (arrival - stamp * 1.0e-9) if self._clock_offset is None else 0.0
        largest = _MAX_LEAD if refused_advance < _CONFIRMATION else _MAX_ADVANCE
        if step > 0.0 and lead <= largest:
            return None
        self._contradicted_since = min(self._contradicted_since, arrival)
        if arrival - self._contradicted_since >= _REBASE:
            self._new_time = True
            return None
        if step == 0.0:
            return f"header.stamp does not advance from {stamp * 1e-9:.3f} s"
        if step < 0.0:
            return f"header.stamp is {-step:.3f} s before the last message"
        return f"header.stamp is {lead:.3f} s ahead of the previous messages"

    def age(self, now: float) -> float:
        """Return the age of the newest accepted message at a local time, s; infinite before the first one.

        It is at least the advance of later refused timestamps, because the local clock may be slow.
        """
        if self._arrival == -math.inf:
            return math.inf
        if self._clock_offset is not None:
            age = now + self.clock_stall + self._clock_offset() - self._stamp * 1.0e-9
        else:
            age = now - self._arrival + (self._lag - self._offset)
        return self._refused_advance if self._refused_advance > age else age  # NaN stays NaN

    def transit_time(self, now: float) -> float:
        """Return the transit time in the newest message's age, s; initially 0."""
        return self.age(now) - (now - self._arrival) if self._arrival > -math.inf else 0.0
