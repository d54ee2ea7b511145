"""Time from each state to its torques at a transport."""

import functools
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from wbc_controller.middleware.stamps import header_stamp
from wbc_controller.middleware.topics import Endpoint
from wbc_controller.middleware.transports.transport import Publish, Transport, TransportWrapper
from wbc_controller.records import Array

QUANTILES = {"median": 0.5, "p99": 0.99, "p99.9": 0.999}  # reported quantiles, by name
_LAST_TIMEOUT = 0.1  # for the last state, s


@dataclass(frozen=True, slots=True)
class RoundTrips:
    """Round trips of consecutive states."""

    seconds: Array  # time from each state to its torques, (n,) in s; inf without torques
    delays: Array  # time between two states beyond the period, (n - 1,) in s, at least 0
    period: float  # s

    @property
    def quantiles(self) -> tuple[float, ...]:
        """The `QUANTILES` of finite round trips, s; NaN without any."""
        return _quantiles(self.seconds[np.isfinite(self.seconds)])

    @property
    def delay_quantiles(self) -> tuple[float, ...]:
        """The `QUANTILES` of the delays, s; NaN without any."""
        return _quantiles(self.delays)

    @property
    def unanswered(self) -> int:
        """Number of states without torques."""
        return int(np.sum(~np.isfinite(self.seconds)))

    @property
    def late(self) -> int:
        """Number of states without torques within a period: missed deadlines."""
        return int(np.sum(~(self.seconds <= self.period)))


def joined(parts: Sequence[RoundTrips]) -> RoundTrips:
    """Return the round trips of several blocks, with the period of the first."""
    return RoundTrips(
        np.concatenate([part.seconds for part in parts]),
        np.concatenate([part.delays for part in parts]),
        parts[0].period,
    )


def round_trips(
    states: Sequence[tuple[float, int]], efforts: Sequence[float], commands: Iterable[tuple[float, int]], period: float
) -> RoundTrips:
    """Assign torques to states.

    Torques have no stamp. The following joint commands have the stamp of their state. A command belongs to the newest
    torques after the previous command and its state; otherwise its own arrival counts.

    Args:
        states: send time, s, and stamp, ns.
        efforts: arrival times of torques, s, ascending.
        commands: arrival time, s, ascending, and stamp, ns.
    """
    arrivals: dict[int, float] = {}
    times, before = np.array(efforts), -np.inf
    send_times = {stamp: when for when, stamp in states}
    for when, stamp in commands:
        newest = int(np.searchsorted(times, when, side="right")) - 1
        at = times[newest] if newest >= 0 and times[newest] > max(before, send_times.get(stamp, -np.inf)) else when
        arrivals.setdefault(stamp, float(at))
        before = when
    sent = np.array([when for when, _ in states])
    answered = np.array([arrivals.get(stamp, np.inf) for _, stamp in states])
    return RoundTrips(answered - sent, np.maximum(np.diff(sent) - period, 0.0), period)


class Meter(TransportWrapper):
    """A transport that records the times of states, torques and joint commands."""

    def __init__(self, transport: Transport) -> None:
        super().__init__(transport)
        self._clear()

    def advertise(self, endpoint: Endpoint) -> Publish:
        """See `Transport`."""
        publish = self._transport.advertise(endpoint)
        if endpoint.key != "joint_states":
            return publish

        def timed(payload: bytes) -> None:
            self._states.append((time.perf_counter(), header_stamp(payload)))
            publish(payload)

        return timed

    def _receiver(self, endpoint: Endpoint) -> Callable[[bytes], bool]:
        def timed(payload: bytes) -> bool:
            now = time.perf_counter()
            if endpoint.key == "effort":
                self._efforts.append(now)
            elif endpoint.key == "joint_commands":
                self._commands.append((now, header_stamp(payload)))
            return True

        return timed

    @property
    def answered(self) -> bool:
        """True if torques have arrived."""
        return bool(self._efforts)

    def measure(self, seconds: float, period: float) -> Callable[[], RoundTrips]:
        """Record for `seconds` with states from another thread; the result assigns torques after its end."""
        self._clear()
        time.sleep(seconds)
        states = self._states.copy()
        time.sleep(_LAST_TIMEOUT)
        return functools.partial(round_trips, states, self._efforts.copy(), self._commands.copy(), period)

    def _clear(self) -> None:
        self._states: list[tuple[float, int]] = []
        self._efforts: list[float] = []
        self._commands: list[tuple[float, int]] = []


def _quantiles(values: Array) -> tuple[float, ...]:
    if not values.size:
        return (float("nan"),) * len(QUANTILES)
    return tuple(np.quantile(values, list(QUANTILES.values()), method="higher").tolist())
