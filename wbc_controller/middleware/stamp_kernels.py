"""Stamps of one stream of messages, and the age of the newest, as `middleware.stamps` explains them.

What is remembered of a stream are `SIZE` numbers; the last two are times in ns, the bits of integers.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from wbc_controller.compiled import INTEGER, NUMBER, VECTOR, VECTOR_OUT, compile_all, compiled, part
from wbc_controller.records import Array

#: A stamp further ahead of where its stream should be is refused, s: latency varies by less.
AHEAD = 0.25
#: By how much the clock of the stamps may be slower than ours, as a share of our time: a simulator at half speed.
_SLOWER = 0.5
#: Most of the lag that one gap between messages may explain in this way, s. A process that was stopped sees such a gap.
_GAP = 0.025

#: How far the stamps have gone on, those that were refused too, since our clock moved last, s.
STOOD = 0
#: Of the newest message, whether it was accepted or not: by how much its stamp rose, s, and when it came, s.
STEP, CAME = 1, 2
#: By how much the stamps of refused messages went on since one was accepted, s.
REFUSED = 3
#: Of the newest message that was accepted: when it came, and what it lags, s.
ARRIVAL, LAG = 4, 5
#: The least lag, and by what it may still rise, s.
OFFSET, _MAY_RISE = 6, 7
#: Whether the newest message was refused, 0 or 1.
LAST_REFUSED = 8
#: Whether the stamps' clock is known, 0 or 1; otherwise its offset from ours is learned.
_KNOWN = 9
#: Stamps of the newest message, and of the newest that was accepted, ns.
NEWEST, STAMP = 10, 11
SIZE = 12


def nothing(*, known: bool) -> Array:
    """What is remembered where no message has come, (SIZE,).

    Args:
        known: whether the stamps' clock is known.
    """
    memory = np.zeros(SIZE)
    memory[_KNOWN] = known
    memory[[CAME, ARRIVAL]] = -math.inf
    memory[OFFSET] = math.inf
    return memory


@part
def _since(memory: Array, place: int, stamp: int) -> Any:
    """By how much a stamp is later than a remembered one, s."""
    return (stamp - memory.view(np.int64)[place]) * 1.0e-9


@part
def is_plain(memory: Array, stamp: int, arrival: float, ahead: float, tolerance: float) -> Any:
    """Whether a stamp is accepted without a closer look; arguments as of `judged`."""
    rise = _since(memory, STAMP, stamp)
    if memory[LAST_REFUSED] != 0.0 or not rise > 0.0:
        return False
    if memory[_KNOWN] != 0.0:
        return stamp * 1.0e-9 - (arrival + ahead) <= tolerance
    return rise <= AHEAD + (arrival - memory[ARRIVAL])


@part
def notice(memory: Array, stamp: int, arrival: float) -> None:
    """Take the stamp of a message as the newest, whether it is accepted or not."""
    step = _since(memory, NEWEST, stamp)
    if arrival != memory[CAME]:
        memory[STOOD] = 0.0
    elif 0.0 < step <= AHEAD:  # another step is a stamp that contradicts the others
        memory[STOOD] += step
    memory[STEP], memory[CAME] = step, arrival
    memory.view(np.int64)[NEWEST] = stamp


@part
def accept(memory: Array, stamp: int, arrival: float) -> None:
    """Learn from a stamp that is accepted."""
    rise, lag = _since(memory, STAMP, stamp), arrival - stamp * 1.0e-9
    may_rise = memory[_MAY_RISE] + _SLOWER * (arrival - memory[ARRIVAL])
    if may_rise > _GAP:
        may_rise = _GAP
    if rise > may_rise:
        rise = may_rise
    elif rise < 0.0:
        rise = 0.0
    memory[_MAY_RISE] = may_rise - rise
    offset = memory[OFFSET] + rise
    memory[OFFSET] = offset if offset < lag else lag
    memory[LAG], memory[ARRIVAL] = lag, arrival
    memory.view(np.int64)[STAMP] = stamp


@part
def age_of(memory: Array, now: float, ahead: float) -> Any:
    """As `age`."""
    if memory[ARRIVAL] == -math.inf:
        return math.inf
    if memory[_KNOWN] != 0.0:
        age = now + memory[STOOD] + ahead - memory.view(np.int64)[STAMP] * 1.0e-9
    else:
        age = now - memory[ARRIVAL] + (memory[LAG] - memory[OFFSET])
    return memory[REFUSED] if memory[REFUSED] > age else age  # not for NaN


@compiled(VECTOR_OUT, INTEGER, NUMBER, NUMBER, NUMBER)
def judged(memory: Array, stamp: int, arrival: float, ahead: float, tolerance: float) -> Any:
    """Take the stamp of a message, and accept it where it needs no closer look.

    Args:
        memory: of the stream, (SIZE,).
        stamp: of the message, ns, above 0.
        arrival: when it came, s on our clock.
        ahead: time of the stamps' clock less ours, s, where it is known.
        tolerance: how far a stamp may be ahead of that clock, s.

    Returns:
        Whether it was accepted.
    """
    plain = is_plain(memory, stamp, arrival, ahead, tolerance)
    notice(memory, stamp, arrival)
    if plain:
        accept(memory, stamp, arrival)
    return plain


@compiled(VECTOR_OUT, INTEGER, NUMBER)
def accepted(memory: Array, stamp: int, arrival: float) -> None:
    """Accept a stamp that `judged` has not, after a closer look."""
    memory[REFUSED] = memory[LAST_REFUSED] = 0.0
    accept(memory, stamp, arrival)


@compiled(VECTOR, NUMBER, NUMBER)
def age(memory: Array, now: float, ahead: float) -> Any:
    """Age of what the newest message says, s; infinite where none was accepted.

    It is at least what the stamps of messages that were refused have gone on since: our clock may be too slow.

    Args:
        memory: of the stream, (SIZE,).
        now: s, on our clock.
        ahead: time of the stamps' clock less ours, s, where it is known.
    """
    return age_of(memory, now, ahead)


compile_all()
