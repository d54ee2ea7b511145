"""The interface of every transport: it opens the endpoints of the topic table, and carries serialized messages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from wbc_controller.wire.topics import Endpoint

#: Sends one serialized message: little-endian CDR with its four-byte encapsulation header.
Publish = Callable[[bytes], None]


class Transport(Protocol):
    """Carries messages in ROS 2's serialized form, so that one codec (`wire.messages`) serves all transports.

    Callbacks run on the transport's thread: they must be short and must not raise.
    """

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

    def close(self) -> None:
        """Close all topics. No callback runs after this returns."""
        ...
