"""A transport that records what passes through it."""

from __future__ import annotations

from collections.abc import Callable

from wbc_controller.middleware.topics import Endpoint
from wbc_controller.middleware.transports.transport import Publish, Stream, Transport


class RecordingTransport:
    """Passes messages on, and records them: outgoing ones after they were sent, so that none waits for it."""

    def __init__(
        self,
        transport: Transport,
        channel: Callable[[str, str], int],
        came: Callable[[int, bytes], None],
        went: Callable[[int, bytes], None],
        *,
        all_of_it: bool,
    ) -> None:
        """Make a tap.

        Args:
            transport: carries the messages.
            channel: gives the number of a topic and type.
            came: takes what came in: number of its channel, and bytes.
            went: takes what went out, likewise.
            all_of_it: whether the recording is to hold what nobody reads, too.
        """
        self.discovery_time = transport.discovery_time
        self._transport = transport
        self._channel = channel
        self._came, self._went = came, went
        self._all_of_it = all_of_it

    def advertise(self, endpoint: Endpoint) -> Publish:
        """Open a topic for writing."""
        publish = self._transport.advertise(endpoint)
        went, channel = self._went, self._channel(endpoint.name, endpoint.type)

        def send(payload: bytes) -> None:
            publish(payload)
            went(channel, payload)

        return send

    def subscribe(self, endpoint: Endpoint, callback: Callable[[bytes], None]) -> None:
        """Open a topic for reading."""
        came, channel = self._came, self._channel(endpoint.name, endpoint.type)

        def receive(payload: bytes) -> None:
            came(channel, payload)
            callback(payload)

        self._transport.subscribe(endpoint, receive)

    def stream(self, endpoint: Endpoint, depth: int) -> Stream:
        """Open a topic for reading, whose messages wait until they are taken: then they are recorded."""
        return _RecordingStream(
            self._transport.stream(endpoint, depth), self._came, self._channel(endpoint.name, endpoint.type)
        )

    def publishers(self, endpoint: Endpoint) -> tuple[str, ...]:
        """As the transport."""
        return self._transport.publishers(endpoint)

    def is_read(self, endpoint: Endpoint) -> bool:
        """As the transport, but that a recording of all of a run reads what it is given."""
        return self._all_of_it or self._transport.is_read(endpoint)

    def close(self) -> None:
        """As the transport."""
        self._transport.close()


class _RecordingStream:
    """A stream that records what is taken from it."""

    def __init__(self, stream: Stream, came: Callable[[int, bytes], None], channel: int) -> None:
        self._stream, self._came, self._channel = stream, came, channel
        self.wait, self.wake = stream.wait, stream.wake

    def take(self) -> list[bytes]:
        """The serialized messages since the last call, oldest first."""
        taken = self._stream.take()
        for payload in taken:
            self._came(self._channel, payload)
        return taken
