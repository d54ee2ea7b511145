"""Transport that records its messages."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Protocol

from wbc_controller.middleware.topics import Endpoint
from wbc_controller.middleware.transports.transport import Publish, Stream, Transport


class MessageRecorder(Protocol):
    """Recorder of messages by number of the topic; with `whole_run` also of topics without other subscriptions."""

    whole_run: bool

    def channel(self, topic: str, kind: str) -> int: ...  # noqa: D102

    def record_incoming(self, topic: int, payload: bytes) -> None: ...  # noqa: D102

    def record_outgoing(self, topic: int, payload: bytes) -> None: ...  # noqa: D102


class RecordingTransport:
    """Wrapper that records messages; outgoing ones after they were sent."""

    def __init__(self, transport: Transport, recorder: MessageRecorder) -> None:
        self.discovery_time = transport.discovery_time
        self._transport, self._recorder = transport, recorder

    def advertise(self, endpoint: Endpoint) -> Publish:
        """See `Transport`."""
        publish = self._transport.advertise(endpoint)
        record, topic = self._recorder.record_outgoing, self._recorder.channel(endpoint.name, endpoint.type)

        def send(payload: bytes) -> None:
            publish(payload)
            record(topic, payload)

        return send

    def subscribe(self, endpoint: Endpoint, callback: Callable[[bytes], None]) -> None:
        """See `Transport`."""
        record, topic = self._recorder.record_incoming, self._recorder.channel(endpoint.name, endpoint.type)

        def receive(payload: bytes) -> None:
            record(topic, payload)
            callback(payload)

        self._transport.subscribe(endpoint, receive)

    def stream(self, endpoint: Endpoint, depth: int) -> Stream:
        """See `Transport`."""
        stream = self._transport.stream(endpoint, depth)
        topic = self._recorder.channel(endpoint.name, endpoint.type)
        return _RecordingStream(stream, partial(self._recorder.record_incoming, topic))

    def publishers(self, endpoint: Endpoint) -> tuple[str, ...]:
        """See `Transport`."""
        return self._transport.publishers(endpoint)

    def has_reader(self, endpoint: Endpoint) -> bool:
        """Return True with a subscription, or if the whole run is recorded."""
        return self._recorder.whole_run or self._transport.has_reader(endpoint)

    def close(self) -> None:
        """See `Transport`."""
        self._transport.close()


class _RecordingStream:
    def __init__(self, stream: Stream, record: Callable[[bytes], None]) -> None:
        self._stream, self._record = stream, record
        self.wait, self.wake = stream.wait, stream.wake

    def take(self) -> list[bytes]:
        """See `Stream`."""
        taken = self._stream.take()
        for payload in taken:
            self._record(payload)
        return taken
