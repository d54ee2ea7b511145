"""Transport that records its messages."""

from __future__ import annotations

from collections.abc import Callable

from wbc_controller.middleware.topics import Endpoint
from wbc_controller.middleware.transports.transport import Publish, Stream, Transport


class RecordingTransport:
    """Wrapper that records messages; outgoing ones after they were sent.

    Args:
        add_topic: returns the number of a topic and type.
        record_incoming, record_outgoing: called with the number of the topic and the bytes of a message.
        whole_run: record topics without other subscriptions too.
    """

    def __init__(
        self,
        transport: Transport,
        add_topic: Callable[[str, str], int],
        record_incoming: Callable[[int, bytes], None],
        record_outgoing: Callable[[int, bytes], None],
        *,
        whole_run: bool,
    ) -> None:
        self.discovery_time = transport.discovery_time
        self._transport = transport
        self._add_topic = add_topic
        self._record_incoming, self._record_outgoing = record_incoming, record_outgoing
        self._whole_run = whole_run

    def advertise(self, endpoint: Endpoint) -> Publish:
        """See `Transport`."""
        publish = self._transport.advertise(endpoint)
        record_outgoing, topic = self._record_outgoing, self._add_topic(endpoint.name, endpoint.type)

        def send(payload: bytes) -> None:
            publish(payload)
            record_outgoing(topic, payload)

        return send

    def subscribe(self, endpoint: Endpoint, callback: Callable[[bytes], None]) -> None:
        """See `Transport`."""
        record_incoming, topic = self._record_incoming, self._add_topic(endpoint.name, endpoint.type)

        def receive(payload: bytes) -> None:
            record_incoming(topic, payload)
            callback(payload)

        self._transport.subscribe(endpoint, receive)

    def stream(self, endpoint: Endpoint, depth: int) -> Stream:
        """See `Transport`."""
        stream = self._transport.stream(endpoint, depth)
        return _RecordingStream(stream, self._record_incoming, self._add_topic(endpoint.name, endpoint.type))

    def publishers(self, endpoint: Endpoint) -> tuple[str, ...]:
        """See `Transport`."""
        return self._transport.publishers(endpoint)

    def has_reader(self, endpoint: Endpoint) -> bool:
        """Return True with a subscription, or if the whole run is recorded."""
        return self._whole_run or self._transport.has_reader(endpoint)

    def close(self) -> None:
        """See `Transport`."""
        self._transport.close()


class _RecordingStream:
    def __init__(self, stream: Stream, record_incoming: Callable[[int, bytes], None], topic: int) -> None:
        self._stream, self._record_incoming, self._topic = stream, record_incoming, topic
        self.wait, self.wake = stream.wait, stream.wake

    def take(self) -> list[bytes]:
        """See `Stream`."""
        taken = self._stream.take()
        for payload in taken:
            self._record_incoming(self._topic, payload)
        return taken
