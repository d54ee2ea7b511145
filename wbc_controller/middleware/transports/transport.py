"""The interface of every transport, and what they share: translated errors, and one message type per topic."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Protocol

from wbc_controller.errors import TransportError
from wbc_controller.middleware.topics import Endpoint

#: Sends one serialized message: little-endian CDR with its four-byte encapsulation header.
Publish = Callable[[bytes], None]
#: Stands for a node whose name is not known: it is not a ROS 2 node, or its name has not arrived yet.
UNNAMED = "(a participant without a node name)"


class Stream(Protocol):
    """A topic whose newest messages wait until they are taken: no thread runs when one comes."""

    def take(self) -> list[bytes]:
        """Take the serialized messages since the last call, oldest first, at most as many as the stream keeps.

        Raises:
            TransportError: if the transport is closed, or the topic cannot be read.
        """
        ...

    def wait(self, seconds: float) -> bool:
        """Wait for a message or for `wake`, at most `seconds` of wall time; True if one of them came in time.

        Another thread may use the interpreter meanwhile.

        Raises:
            TransportError: if the transport is closed, or the topic cannot be read.
        """
        ...

    def wake(self) -> None:
        """End the present or else the next wait. Any thread may call it."""
        ...


class Transport(Protocol):
    """Carries messages in ROS 2's serialized form, so that one codec (`middleware.codec`) serves all transports.

    Callbacks run on the transport's thread: they must be short and must not raise.

    Attributes:
        discovery_time: time after which the other nodes know what this one has opened, and the reverse, s; longer on a
            machine that is overloaded.
    """

    discovery_time: float

    def advertise(self, endpoint: Endpoint) -> Publish:
        """Open a topic for writing.

        Returns:
            A function that sends one serialized message. It may be called from any thread.

        Raises:
            TransportError: if the topic cannot be opened.
        """
        ...

    def subscribe(self, endpoint: Endpoint, callback: Callable[[bytes], None]) -> None:
        """Open a topic for reading; the callback is called with each serialized message.

        Raises:
            TransportError: if the topic cannot be opened.
        """
        ...

    def stream(self, endpoint: Endpoint, depth: int) -> Stream:
        """Open a topic for reading, whose newest `depth` messages wait until they are taken.

        Raises:
            TransportError: if the topic cannot be opened.
        """
        ...

    def publishers(self, endpoint: Endpoint) -> tuple[str, ...]:
        """Fully qualified node name of each publisher on a topic, other than this transport's own, sorted.

        A node with the same name as this one is another. `UNNAMED` stands for a name that is not known. The answer may
        lag behind the graph; it takes up to a millisecond.

        Raises:
            TransportError: if the transport is closed, or the graph cannot be read.
        """
        ...

    def is_read(self, endpoint: Endpoint) -> bool:
        """Return True if a topic that this transport has opened for writing has a reader.

        Raises:
            TransportError: if the transport is closed.
        """
        ...

    def close(self) -> None:
        """Close all topics. No callback runs after this returns."""
        ...


@contextlib.contextmanager
def translated_errors(attempt: str, *kinds: type[Exception]) -> Iterator[None]:
    """Translate errors of a middleware, of the given kinds, into a `TransportError` that names the attempt."""
    try:
        yield
    except TransportError:
        raise
    except kinds as error:
        raise TransportError(f"{attempt}: {error}") from error


class TopicTypes:
    """The message type of each open topic. It is not thread-safe: its owner holds a lock."""

    def __init__(self) -> None:
        self._type_of: dict[str, str] = {}

    def check(self, topic: str, type_name: str) -> None:
        """Record the type with which a topic is opened.

        Raises:
            TransportError: if the topic is already open with another type.
        """
        known = self._type_of.setdefault(topic, type_name)
        if known != type_name:
            raise TransportError(f"topic {topic} is already open as {known}: it cannot also be {type_name}")
