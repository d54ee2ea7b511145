"""Ages by stamp: how old a message's content is, on a clock whose offset from ours is learned."""

from __future__ import annotations

import math

#: A stamp further ahead of where its stream should be is refused, s: latency varies by less.
_AHEAD = 0.25
#: Stamps that contradict those before for this long are a new time, s on our clock.
_REBASE = 0.3
#: By how much the clock of the stamps may be slower than ours, as a share of its own time: a simulator at half speed.
_SLOWER = 1.0


class StampTracker:
    """Judges the stamps of one stream of messages, and tells the age of the newest.

    With the lag of a message, its arrival on our clock less its stamp, the smallest lag is the offset between the two
    clocks and the shortest latency. What a later message lags more, it waited on its way: in a queue of a process that
    was stopped, say. The offset may rise by `_SLOWER` of the time between stamps, so that a clock that drifts, or a
    simulator that is slower than real time, is not mistaken for latency. A latency that is constant from the start
    cannot be told from an offset between two clocks.

    Stamps have to rise. One that does not, or that is far ahead, is refused; where they go on so for `_REBASE`, the
    stream has a new time.
    """

    def __init__(self) -> None:
        self._stamp = 0  # of the newest message that was accepted, ns
        self._arrival = -math.inf
        self._offset = math.inf
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
        if self._arrival > -math.inf:
            reason = self._contradiction(stamp, arrival)
            if reason is not None:
                self._contradicted = min(self._contradicted, arrival)
                if arrival - self._contradicted < _REBASE:
                    return reason
                self._offset = math.inf
        self._contradicted = math.inf
        lag = arrival - stamp * 1.0e-9
        self._offset = min(lag, self._offset + _SLOWER * max(stamp - self._stamp, 0) * 1.0e-9)
        self._lag, self._stamp, self._arrival = lag, stamp, arrival
        return None

    def age(self, now: float) -> float:
        """Age of what the newest message says, s; infinite where none was accepted.

        Args:
            now: s, on our clock.
        """
        return now - self._arrival + (self._lag - self._offset) if self._arrival > -math.inf else math.inf

    def _contradiction(self, stamp: int, arrival: float) -> str | None:
        step = (stamp - self._stamp) * 1.0e-9
        if step == 0.0:
            return f"header.stamp stands still at {stamp * 1e-9:.3f} s"
        if step < 0.0:
            return f"header.stamp is {-step:.3f} s before that of the last message"
        ahead = step - (arrival - self._arrival)
        if ahead > _AHEAD:
            return f"header.stamp is {ahead:.3f} s ahead of the messages before"
        return None
