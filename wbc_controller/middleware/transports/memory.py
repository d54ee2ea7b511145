"""Messages within one process, without middleware, threads or waiting, for tests and simulation."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable

from wbc_controller.errors import TransportError
from wbc_controller.middleware.topics import Endpoint
from wbc_controller.middleware.transports.transport import Publish, TopicTypes

_log = logging.getLogger(__name__)

_Callback = Callable[[bytes], None]


class MemoryBus:
    """The readers of each topic, and the last message of latched topics, shared by the participants of one process.

    Messages are delivered on the publisher's thread, before ``publish()`` returns. As in ROS 2, a reader that requests
    reliable or latched messages is not connected to a writer that offers less.
    """

    def __init__(self) -> None:
        # Re-entrant, because a callback may publish, as a simulated robot does in lockstep.
        self.lock = threading.RLock()
        self.types = TopicTypes()
        self._readers: dict[str, list[_Reader]] = {}
        self._writers: dict[str, list[_Writer]] = {}
        self._latched: dict[str, dict[_Writer, bytes]] = {}

    def _open(self, writer: _Writer) -> None:
        with self.lock:
            self._writers.setdefault(writer.endpoint.name, []).append(writer)

    def _owners(self, topic: str) -> list[MemoryTransport]:
        with self.lock:
            return [writer.owner for writer in self._writers.get(topic, ())]

    def _is_read(self, writers: list[_Writer]) -> bool:
        with self.lock:
            return any(
                reader.matches(writer.endpoint)
                for writer in writers
                for reader in self._readers.get(writer.endpoint.name, ())
            )

    def _connect(self, reader: _Reader) -> None:
        with self.lock:
            self._readers.setdefault(reader.endpoint.name, []).append(reader)
            if reader.endpoint.qos.latched:
                for writer, payload in list(self._latched.get(reader.endpoint.name, {}).items()):
                    reader.deliver(writer.endpoint, payload)

    def _publish(self, writer: _Writer, payload: bytes) -> None:
        with self.lock:
            if writer.closed:
                raise TransportError(f"cannot publish on {writer.endpoint.name}: the transport is closed")
            if writer.endpoint.qos.latched:
                self._latched.setdefault(writer.endpoint.name, {})[writer] = payload
            for reader in list(self._readers.get(writer.endpoint.name, ())):
                reader.deliver(writer.endpoint, payload)

    def _disconnect(self, readers: list[_Reader], writers: list[_Writer]) -> None:
        with self.lock:
            for reader in readers:
                reader.closed = True
                self._readers[reader.endpoint.name].remove(reader)
            for writer in writers:
                writer.closed = True
                self._writers[writer.endpoint.name].remove(writer)
                self._latched.get(writer.endpoint.name, {}).pop(writer, None)


class MemoryTransport:
    """One participant on a `MemoryBus`.

    Attributes:
        name: fully qualified name of the node.

    Args:
        bus: connects it with the others.
        node: name of the node.
        namespace: namespace of the node, starting with a slash.
    """

    discovery_time = 0.0

    def __init__(self, bus: MemoryBus, node: str = "memory", namespace: str = "/") -> None:
        self.name = f"{namespace.rstrip('/')}/{node}"
        self._bus = bus
        self._readers: list[_Reader] = []
        self._writers: list[_Writer] = []
        self._closed = False

    def advertise(self, endpoint: Endpoint) -> Publish:
        """Open a topic for writing."""
        with self._bus.lock:
            self._check(endpoint)
            writer = _Writer(endpoint, self)
            self._writers.append(writer)
            self._bus._open(writer)
        return lambda payload: self._bus._publish(writer, payload)

    def subscribe(self, endpoint: Endpoint, callback: Callable[[bytes], None]) -> None:
        """Open a topic for reading; the callback runs on the publisher's thread."""
        with self._bus.lock:
            self._check(endpoint)
            reader = _Reader(endpoint, callback)
            self._readers.append(reader)
            self._bus._connect(reader)

    def stream(self, endpoint: Endpoint, depth: int) -> _Stream:
        """Open a topic for reading, whose messages wait until they are taken."""
        stream = _Stream(endpoint, depth, self)
        self.subscribe(endpoint, stream.put)
        return stream

    def publishers(self, endpoint: Endpoint) -> tuple[str, ...]:
        """Return the node name of each publisher on a topic, other than this transport's own, sorted."""
        self._check_open(f"look at {endpoint.name}")
        return tuple(sorted(owner.name for owner in self._bus._owners(endpoint.name) if owner is not self))

    def is_read(self, endpoint: Endpoint) -> bool:
        """Return True if a topic that this transport has opened for writing has a reader."""
        self._check_open(f"look at {endpoint.name}")
        return self._bus._is_read([writer for writer in self._writers if writer.endpoint.name == endpoint.name])

    def close(self) -> None:
        """Close all topics. A second call does nothing."""
        with self._bus.lock:
            self._closed = True
            self._bus._disconnect(self._readers, self._writers)
            self._readers, self._writers = [], []

    def _check_open(self, attempt: str) -> None:
        if self._closed:
            raise TransportError(f"cannot {attempt}: the transport is closed")

    def _check(self, endpoint: Endpoint) -> None:
        self._check_open(f"open {endpoint.name}")
        self._bus.types.check(endpoint.name, endpoint.type)


class _Stream:
    """The newest messages of a topic."""

    def __init__(self, endpoint: Endpoint, depth: int, owner: MemoryTransport) -> None:
        self._endpoint, self._owner = endpoint, owner
        self._came = threading.Condition()  # guards the two below
        self._newest: deque[bytes] = deque(maxlen=depth)
        self._woken = False

    def put(self, payload: bytes) -> None:
        with self._came:
            self._newest.append(payload)
            self._came.notify()

    def take(self) -> list[bytes]:
        """Take the serialized messages since the last call, oldest first."""
        self._owner._check_open(f"read {self._endpoint.name}")
        with self._came:
            newest = list(self._newest)
            self._newest.clear()
        return newest

    def wait(self, seconds: float) -> bool:
        """Wait for a message or for `wake`, at most `seconds`; True if one of them came in time."""
        self._owner._check_open(f"read {self._endpoint.name}")
        with self._came:
            came = self._came.wait_for(lambda: self._newest or self._woken, seconds)
            self._woken = False
        return bool(came)

    def wake(self) -> None:
        """End the present or else the next wait."""
        with self._came:
            self._woken = True
            self._came.notify()


class _Writer:
    def __init__(self, endpoint: Endpoint, owner: MemoryTransport) -> None:
        self.endpoint = endpoint
        self.owner = owner
        self.closed = False


class _Reader:
    def __init__(self, endpoint: Endpoint, callback: _Callback) -> None:
        self.endpoint = endpoint
        self.closed = False
        self._callback = callback

    def matches(self, offered: Endpoint) -> bool:
        asked = self.endpoint.qos
        return not (self.closed or asked.reliable > offered.qos.reliable or asked.latched > offered.qos.latched)

    def deliver(self, offered: Endpoint, payload: bytes) -> None:
        if not self.matches(offered):
            return
        try:
            self._callback(payload)
        except Exception:  # an error must not stop the publisher or other readers
            _log.exception("callback for %s failed", self.endpoint.name)
