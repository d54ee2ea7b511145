"""A transport on a computer so busy that the transport's thread gets no processor."""

from collections import deque
from collections.abc import Callable

from wbc_controller.middleware.topics import Endpoint
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.middleware.transports.transport import Stream


class StarvedThread(MemoryTransport):
    """Callbacks wait until `run` is called; streams have their messages at once, as they do in C."""

    def __init__(self, bus: MemoryBus) -> None:
        super().__init__(bus)
        self._streams = MemoryTransport(bus)
        self._waiting: deque[tuple[Callable[[bytes], None], bytes]] = deque()

    def subscribe(self, endpoint: Endpoint, callback: Callable[[bytes], None]) -> None:
        """Open a topic for reading; the callback waits."""
        super().subscribe(endpoint, lambda payload: self._waiting.append((callback, payload)))

    def stream(self, endpoint: Endpoint, depth: int) -> Stream:
        """Open a topic for reading, whose messages wait until they are taken."""
        return self._streams.stream(endpoint, depth)

    def run(self) -> None:
        """Run the callbacks of all messages that have arrived."""
        while self._waiting:
            callback, payload = self._waiting.popleft()
            callback(payload)
