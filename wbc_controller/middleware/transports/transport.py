"""Interface of all transports."""

import contextlib
from collections.abc import Callable, Iterator
from typing import Protocol

from wbc_controller.errors import TransportError
from wbc_controller.middleware.topics import Endpoint

#: Function that sends one serialized message: little-endian CDR with its encapsulation header.
Publish = Callable[[bytes], None]
UNNAMED = "(a participant without a node name)"  # unknown node: not of ROS 2, or with a pending name


class Stream(Protocol):
    """Topic with a queue of its newest messages, read without a callback thread. The methods raise `TransportError`."""

    def take(self) -> list[bytes]:
        """Take the serialized messages of the queue, oldest first."""

    def wait(self, seconds: float) -> bool:
        """Wait for a message or `wake`, at most `seconds` of wall time; return True if one arrived."""

    def wake(self) -> None:
        """End the present or next wait, from any thread."""


class Transport(Protocol):
    """Transport of serialized ROS 2 messages (`middleware.codec`).

    Callbacks run on the transport's thread: they must be short and must not raise. The methods raise `TransportError`.
    """

    discovery_time: float  # of mutual discovery, s

    def advertise(self, endpoint: Endpoint) -> Publish:
        """Open a topic for writing; return the thread-safe function that sends a serialized message."""

    def subscribe(self, endpoint: Endpoint, callback: Callable[[bytes], None]) -> None:
        """Open a topic for reading; the callback receives each serialized message."""

    def stream(self, endpoint: Endpoint, depth: int) -> Stream:
        """Open a topic for reading by hand, with a queue of the newest `depth` messages."""

    def publishers(self, endpoint: Endpoint) -> tuple[str, ...]:
        """Return the full node names (or `UNNAMED`) of the other publishers on a topic, sorted.

        The answer may lag behind the graph; it takes up to 1 ms.
        """

    def has_reader(self, endpoint: Endpoint) -> bool:
        """Return True if an advertised topic has a reader."""

    def close(self) -> None:
        """Close all topics; afterwards no callback runs."""


class TransportWrapper:
    """Transport that passes all calls to another one, and incoming messages through `_receiver`."""

    def __init__(self, transport: Transport) -> None:
        self._transport, self.discovery_time = transport, transport.discovery_time
        self.publishers = transport.publishers

    def _receiver(self, endpoint: Endpoint) -> Callable[[bytes], bool]:
        """Return a function that receives each message of a topic; it drops the message by returning False."""
        return lambda payload: True

    def advertise(self, endpoint: Endpoint) -> Publish:
        """See `Transport`."""
        return self._transport.advertise(endpoint)

    def subscribe(self, endpoint: Endpoint, callback: Callable[[bytes], None]) -> None:
        """See `Transport`."""
        accepts = self._receiver(endpoint)

        def receive(payload: bytes) -> None:
            if accepts(payload):
                callback(payload)

        self._transport.subscribe(endpoint, receive)

    def stream(self, endpoint: Endpoint, depth: int) -> Stream:
        """See `Transport`."""
        return _WrappedStream(self._transport.stream(endpoint, depth), self._receiver(endpoint))

    def has_reader(self, endpoint: Endpoint) -> bool:
        """See `Transport`."""
        return self._transport.has_reader(endpoint)

    def close(self) -> None:
        """See `Transport`."""
        self._transport.close()


class _WrappedStream:
    def __init__(self, stream: Stream, accepts: Callable[[bytes], bool]) -> None:
        self._stream, self._accepts = stream, accepts
        self.wait, self.wake = stream.wait, stream.wake

    def take(self) -> list[bytes]:
        return [payload for payload in self._stream.take() if self._accepts(payload)]


@contextlib.contextmanager
def translated_errors(attempt: str, *kinds: type[Exception]) -> Iterator[None]:
    """Translate middleware errors into a `TransportError` with the attempt."""
    try:
        yield
    except TransportError:
        raise
    except kinds as error:
        raise TransportError(f"{attempt}: {error}") from error


def require_open(closed: bool, attempt: str, topic: str) -> None:
    """Raise `TransportError` with the attempt if a transport is closed."""
    if closed:
        raise TransportError(f"cannot {attempt} {topic}: the transport is closed")


def check_opening(closed: bool, types: dict[str, str], endpoint: Endpoint) -> None:
    """Record the message type of an opened topic; another type, or a closed transport, raises `TransportError`."""
    require_open(closed, "open", endpoint.name)
    known = types.setdefault(endpoint.name, endpoint.type)
    if known != endpoint.type:
        raise TransportError(f"topic {endpoint.name} is already open with type {known}, not {endpoint.type}")
