"""Message delivery only in the active state."""

import logging
from collections.abc import Callable

from wbc_controller.middleware.codec import encode, message
from wbc_controller.middleware.log_limit import LogLimit
from wbc_controller.middleware.topics import REQUEST, Endpoint
from wbc_controller.middleware.transports.transport import Transport, TransportWrapper

_log = logging.getLogger(__name__)


class LifecycleGate(TransportWrapper):
    """Transport that drops messages unless `open` is true, and logs dropped requests."""

    def __init__(self, transport: Transport) -> None:
        super().__init__(transport)
        self.open = False
        self._limit = LogLimit()
        self._command: Callable[[bytes], None] = lambda payload: None

    def subscribe(self, endpoint: Endpoint, callback: Callable[[bytes], None]) -> None:
        """See `Transport`."""
        if endpoint.key == "command":
            self._command = callback
        super().subscribe(endpoint, callback)

    def _receiver(self, endpoint: Endpoint) -> Callable[[bytes], bool]:
        def receive(payload: bytes) -> bool:
            if not self.open and endpoint.qos == REQUEST and self._limit.passes(endpoint.name):
                _log.warning("message on %s ignored: the node is not active", endpoint.name)
            return self.open

        return receive

    def command(self, word: str) -> None:
        """Deliver a command as if it had arrived on the command topic."""
        self._command(encode(message("std_msgs/msg/String", data=word)))

    def close(self) -> None:
        """Close the gate and all topics."""
        self.open = False
        super().close()
