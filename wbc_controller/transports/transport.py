"""What every transport does: open the endpoints of the topic table and move serialized messages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from wbc_controller.wire.topics import Endpoint

#: Takes one serialized message: CDR, little endian, with its four-byte encapsulation header.
Publish = Callable[[bytes], None]


class Transport(Protocol):
    """Moves messages in ROS 2's serialized form, so that one codec (`wire.messages`) serves all transports.

    Callbacks run on a thread of the transport's own: they must be short and never raise.
    """

    def advertise(self, endpoint: Endpoint) -> Publish:
        """Open a topic for writing.

        Returns:
            A function that sends one serialized message. It may be called from any thread.

        Raises:
            TransportError: where the topic cannot be opened.
        """
        ...

    def subscribe(self, endpoint: Endpoint, callback: Callable[[bytes], None]) -> None:
        """Open a topic for reading; each message received from now on goes to the callback, serialized.

        Raises:
            TransportError: where the topic cannot be opened.
        """
        ...

    def close(self) -> None:
        """Close all topics. No callback runs after this returns."""
        ...
