"""Message delivery only in the active state."""

from __future__ import annotations

import logging
from collections.abc import Callable

from wbc_controller.middleware.codec import encode, message
from wbc_controller.middleware.log_limit import LogLimit
from wbc_controller.middleware.topics import REQUEST, Endpoint
from wbc_controller.middleware.transports.transport import Publish, Stream, Transport

_log = logging.getLogger(__name__)


class LifecycleGate:
    """Transport with message delivery only while `open` is true."""

    def __init__(self, transport: Transport) -> None:
        self.open = False
        self._limit = LogLimit()
        self.discovery_time = transport.discovery_time
        self._transport = transport
        self._command: Callable[[bytes], None] = lambda payload: None

    def advertise(self, endpoint: Endpoint) -> Publish:
        """Open a topic for writing."""
        return self._transport.advertise(endpoint)

    def subscribe(self, endpoint: Endpoint, callback: Callable[[bytes], None]) -> None:
        """Open a topic for reading; a closed gate drops messages, and requests with a warning."""
        if endpoint.key == "command":
            self._command = callback

        def deliver(payload: bytes) -> None:
            if self.open:
                callback(payload)
            elif endpoint.qos == REQUEST and self._limit.passes(endpoint.name):
                _log.warning("message on %s ignored: the node is not active", endpoint.name)

        self._transport.subscribe(endpoint, deliver)

    def stream(self, endpoint: Endpoint, depth: int) -> Stream:
        """Open a topic for reading; a closed gate drops taken messages."""
        return _GatedStream(self._transport.stream(endpoint, depth), self)

    def publishers(self, endpoint: Endpoint) -> tuple[str, ...]:
        """Return the node names of the other publishers on a topic, sorted."""
        return self._transport.publishers(endpoint)

    def command(self, word: str) -> None:
        """Deliver a command as if it had arrived on the command topic."""
        self._command(encode(message("std_msgs/msg/String", data=word)))

    def has_reader(self, endpoint: Endpoint) -> bool:
        """Return True if an advertised topic has a reader."""
        return self._transport.has_reader(endpoint)

    def close(self) -> None:
        """Close the gate and all topics."""
        self.open = False
        self._transport.close()


class _GatedStream:
    def __init__(self, stream: Stream, gate: LifecycleGate) -> None:
        self._stream, self._gate = stream, gate
        self.wait, self.wake = stream.wait, stream.wake

    def take(self) -> list[bytes]:
        taken = self._stream.take()
        return taken if self._gate.open else []
