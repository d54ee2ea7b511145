"""The time from each state to its torques: measured at a transport, and summarized."""

import functools
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from wbc_controller.middleware.stamps import header_stamp
from wbc_controller.middleware.topics import Endpoint
from wbc_controller.middleware.transports.transport import Publish, Stream, Transport
from wbc_controller.records import Array

#: The quantiles that are shown: median, p99, p99.9.
QUANTILES = (0.5, 0.99, 0.999)
#: Time after which no more torques are awaited for the last state, s.
_LAST = 0.1


@dataclass(frozen=True, slots=True)
class RoundTrips:
    """The round trips of consecutive states."""

    seconds: Array  # from sending each state until its torques came, (n,) in s; inf where none came
    delays: Array  # by how much the time between two states exceeded the period, (n - 1,) in s; 0 where it did not
    period: float  # of the states, s

    @property
    def quantiles(self) -> tuple[float, ...]:
        """The `QUANTILES` of the round trips of those states that got torques, s; nan where none did."""
        return _quantiles(self.seconds[np.isfinite(self.seconds)])

    @property
    def delay_quantiles(self) -> tuple[float, ...]:
        """The `QUANTILES` of the delays, s; nan where there are none."""
        return _quantiles(self.delays)

    @property
    def unanswered(self) -> int:
        """Number of states that got no torques."""
        return int(np.sum(~np.isfinite(self.seconds)))

    @property
    def late(self) -> int:
        """Number of states that got no torques within a period: the deadlines missed."""
        return int(np.sum(~(self.seconds <= self.period)))


def joined(parts: Sequence[RoundTrips]) -> RoundTrips:
    """The round trips of several blocks as one, with the period of the first."""
    return RoundTrips(
        np.concatenate([part.seconds for part in parts]),
        np.concatenate([part.delays for part in parts]),
        parts[0].period,
    )


def round_trips(
    states: Sequence[tuple[float, int]], efforts: Sequence[float], commands: Iterable[tuple[float, int]], period: float
) -> RoundTrips:
    """Find the torques that belong to each state.

    Torques carry no stamp. The joint commands, which follow them, carry that of their state: to a command belong the
    newest torques that came after the command before it, and after the state was sent. Where these were lost, or are
    read after the command, the command itself counts, as it holds the same torques.

    Args:
        states: when each state was sent, in s, and its stamp, ns.
        efforts: when torques came, in s, ascending.
        commands: when joint commands came, in s, ascending, and their stamps, ns.
        period: of the states, s.
    """
    came: dict[int, float] = {}
    times, before = np.array(efforts), -np.inf
    asked = {stamp: when for when, stamp in states}
    for when, stamp in commands:
        newest = int(np.searchsorted(times, when, side="right")) - 1
        at = times[newest] if newest >= 0 and times[newest] > max(before, asked.get(stamp, -np.inf)) else when
        came.setdefault(stamp, float(at))  # a command may repeat the stamp of a state that has become old
        before = when
    sent = np.array([when for when, _ in states])
    answered = np.array([came.get(stamp, np.inf) for _, stamp in states])
    return RoundTrips(answered - sent, np.maximum(np.diff(sent) - period, 0.0), period)


class Meter:
    """A transport that notes when states go out, and when torques and joint commands come in."""

    def __init__(self, transport: Transport) -> None:
        """Put a meter on a transport."""
        self.discovery_time = transport.discovery_time
        self._transport = transport
        self._forget()

    def advertise(self, endpoint: Endpoint) -> Publish:
        """Open a topic for writing."""
        publish = self._transport.advertise(endpoint)
        if endpoint.key != "joint_states":
            return publish

        def timed(payload: bytes) -> None:
            self._states.append((time.perf_counter(), header_stamp(payload)))
            publish(payload)

        return timed

    def subscribe(self, endpoint: Endpoint, callback: Callable[[bytes], None]) -> None:
        """Open a topic for reading."""

        def timed(payload: bytes) -> None:
            now = time.perf_counter()
            if endpoint.key == "effort":
                self._efforts.append(now)
            else:
                self._commands.append((now, header_stamp(payload)))
            callback(payload)

        self._transport.subscribe(endpoint, timed if endpoint.key in ("effort", "joint_commands") else callback)

    def stream(self, endpoint: Endpoint, depth: int) -> Stream:
        """Open a topic for reading, whose messages wait until they are taken: they are not timed."""
        return self._transport.stream(endpoint, depth)

    def publishers(self, endpoint: Endpoint) -> tuple[str, ...]:
        """Node name of each publisher on a topic, other than this transport's own, sorted."""
        return self._transport.publishers(endpoint)

    def has_reader(self, endpoint: Endpoint) -> bool:
        """Whether somebody reads a topic that was opened for writing."""
        return self._transport.has_reader(endpoint)

    def close(self) -> None:
        """Close all topics."""
        self._transport.close()

    @property
    def answered(self) -> bool:
        """Whether torques have come."""
        return bool(self._efforts)

    def measure(self, seconds: float, period: float) -> Callable[[], RoundTrips]:
        """Let `seconds` pass in which another thread sends states of a period, s, and note the answers.

        Returns:
            Finds the round trips: for when that thread has ended, as it takes the interpreter for hundreds of periods.
        """
        self._forget()
        time.sleep(seconds)
        states = self._states.copy()
        time.sleep(_LAST)
        return functools.partial(round_trips, states, self._efforts.copy(), self._commands.copy(), period)

    def _forget(self) -> None:
        self._states: list[tuple[float, int]] = []
        self._efforts: list[float] = []
        self._commands: list[tuple[float, int]] = []


def _quantiles(values: Array) -> tuple[float, ...]:
    if not values.size:
        return (float("nan"),) * len(QUANTILES)
    return tuple(np.quantile(values, QUANTILES, method="higher").tolist())
