"""A transport that records its messages."""

from __future__ import annotations

from collections.abc import Callable

from wbc_controller.middleware.topics import Endpoint
from wbc_controller.middleware.transports.transport import Publish, Stream, Transport


class RecordingTransport:
    """Passes messages on and records them; outgoing ones after they were sent, so that none is delayed.

    Args:
        add_topic: returns the number of a topic and type.
        came: takes the number of the topic and the bytes of incoming messages.
        went: likewise, of outgoing messages.
        whole_run: True to record topics without other subscriptions, too.
    """

    def __init__(
        self,
        transport: Transport,
        add_topic: Callable[[str, str], int],
        came: Callable[[int, bytes], None],
        went: Callable[[int, bytes], None],
        *,
        whole_run: bool,
    ) -> None:
        self.discovery_time = transport.discovery_time
        self._transport = transport
        self._add_topic = add_topic
        self._came, self._went = came, went
        self._whole_run = whole_run

    def advertise(self, endpoint: Endpoint) -> Publish:
        """Open a topic for writing."""
        publish = self._transport.advertise(endpoint)
        went, topic = self._went, self._add_topic(endpoint.name, endpoint.type)

        def send(payload: bytes) -> None:
            publish(payload)
            went(topic, payload)

        return send

    def subscribe(self, endpoint: Endpoint, callback: Callable[[bytes], None]) -> None:
        """Open a topic for reading."""
        came, topic = self._came, self._add_topic(endpoint.name, endpoint.type)

        def receive(payload: bytes) -> None:
            came(topic, payload)
            callback(payload)

        self._transport.subscribe(endpoint, receive)

    def stream(self, endpoint: Endpoint, depth: int) -> Stream:
        """Open a topic for reading whose messages are recorded when they are taken."""
        stream = self._transport.stream(endpoint, depth)
        return _RecordingStream(stream, self._came, self._add_topic(endpoint.name, endpoint.type))

    def publishers(self, endpoint: Endpoint) -> tuple[str, ...]:
        """Return the names of the publishers, as the transport."""
        return self._transport.publishers(endpoint)

    def is_read(self, endpoint: Endpoint) -> bool:
        """Return True if there is a subscription; a recording of the whole run is one."""
        return self._whole_run or self._transport.is_read(endpoint)

    def close(self) -> None:
        """Close the transport."""
        self._transport.close()


class _RecordingStream:
    """A stream that records the messages that are taken from it."""

    def __init__(self, stream: Stream, came: Callable[[int, bytes], None], topic: int) -> None:
        self._stream, self._came, self._topic = stream, came, topic
        self.wait, self.wake = stream.wait, stream.wake

    def take(self) -> list[bytes]:
        """Return the serialized messages since the last call, oldest first."""
        taken = self._stream.take()
        for payload in taken:
            self._came(self._topic, payload)
        return taken
