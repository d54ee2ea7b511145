"""The other end of a node's topics on the memory transport."""

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import numpy as np

from wbc_controller.middleware.codec import decode, encode, message, torques
from wbc_controller.middleware.topics import MOCK_NODE, MOCK_TOPICS, Direction, Endpoint, counterpart, endpoints
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.settings import Settings


class Sender:
    """Sends messages to a node, and takes all that it publishes; `all` returns the messages of a topic."""

    def __init__(self, transport: MemoryTransport, topics: Iterable[Endpoint]) -> None:
        self.user = transport
        self._publish: dict[tuple[str, str], Callable[[bytes], None]] = {}
        for topic in topics:
            if topic.direction is Direction.IN:
                self._publish[topic.key, topic.subject] = transport.advertise(counterpart(topic))
            else:
                transport.subscribe(counterpart(topic), partial(self._take, topic))

    @property
    def status(self) -> Any:
        """The newest status of the node, the only one of its message."""
        (status,) = self.all("diagnostics")[-1].status
        return status

    @property
    def values(self) -> dict[str, str]:
        """The values of the newest status by key."""
        return {each.key: each.value for each in self.status.values}

    def send_bytes(self, key: str, payload: bytes, subject: str = "") -> None:
        self._publish[key, subject](payload)

    def send(self, key: str, content: Any, subject: str = "") -> None:
        self.send_bytes(key, encode(content), subject)

    def say(self, key: str, text: str) -> None:
        self.send(key, message("std_msgs/msg/String", data=text))


class Peer(Sender):
    """The other end of a node's topics; keeps the messages in order.

    Attributes:
        received: key, subject and content of each message.
        reactions: called with the content of each message, by key.
    """

    def __init__(self, bus: MemoryBus, topics: Iterable[Endpoint]) -> None:
        self.received: list[tuple[str, str, Any]] = []
        self.reactions: dict[str, Callable[[Any], None]] = {}
        self.transport = MemoryTransport(bus)
        super().__init__(self.transport, topics)

    def _take(self, topic: Endpoint, payload: bytes) -> None:
        content = decode(payload, topic.type)
        self.received.append((topic.key, topic.subject, content))
        self.reactions.get(topic.key, lambda content: None)(content)

    def all(self, key: str) -> list[Any]:
        """All messages of a topic."""
        return [content for received, _, content in self.received if received == key]


class MockPeer(Peer):
    """The other end of the mock robot's topics."""

    def __init__(self, bus: MemoryBus, settings: Settings) -> None:
        super().__init__(bus, endpoints(MOCK_TOPICS, MOCK_NODE, settings))

    def effort(self, tau: Any) -> None:
        self.send("effort", torques(np.asarray(tau, dtype=np.float64)))
