"""In-process transport for tests and simulation."""

import logging
import threading
from collections import defaultdict, deque
from collections.abc import Callable

from wbc_controller.middleware.topics import Endpoint
from wbc_controller.middleware.transports.transport import Publish, check_opening, require_open

_log = logging.getLogger(__name__)


class MemoryBus:
    """Readers and writers of all topics, with delivery on the publisher's thread and ROS 2's QoS matching."""

    def __init__(self) -> None:
        # Re-entrant, because callbacks may publish, as in lockstep.
        self.lock = threading.RLock()
        self.types: dict[str, str] = {}  # by topic
        self.readers: defaultdict[str, list[_Reader]] = defaultdict(list)
        self.writers: defaultdict[str, list[_Writer]] = defaultdict(list)


class MemoryTransport:
    """One participant on a `MemoryBus`."""

    discovery_time = 0.0

    def __init__(self, bus: MemoryBus, node: str = "memory", namespace: str = "/") -> None:
        self.name = f"{namespace.rstrip('/')}/{node}"  # fully qualified name of the node
        self._bus = bus
        self.closed = False

    def advertise(self, endpoint: Endpoint) -> Publish:
        """See `Transport`."""
        with self._bus.lock:
            check_opening(self.closed, self._bus.types, endpoint)
            writer = _Writer(endpoint, self, self._bus)
            self._bus.writers[endpoint.name].append(writer)
        return writer.publish

    def subscribe(self, endpoint: Endpoint, callback: Callable[[bytes], None]) -> None:
        """See `Transport`; callbacks run on the publisher's thread."""
        with self._bus.lock:
            check_opening(self.closed, self._bus.types, endpoint)
            reader = _Reader(endpoint, callback, self)
            self._bus.readers[endpoint.name].append(reader)
            for writer in list(self._bus.writers[endpoint.name]) if endpoint.qos.latched else ():
                if writer.latched is not None:
                    reader.deliver(writer.endpoint, writer.latched)

    def stream(self, endpoint: Endpoint, depth: int) -> "_Stream":
        """See `Transport`."""
        stream = _Stream(endpoint, depth, self)
        self.subscribe(endpoint, stream.put)
        return stream

    def publishers(self, endpoint: Endpoint) -> tuple[str, ...]:
        """See `Transport`."""
        require_open(self.closed, "query", endpoint.name)
        with self._bus.lock:
            owners = [writer.owner for writer in self._bus.writers[endpoint.name]]
        return tuple(sorted(owner.name for owner in owners if owner is not self))

    def has_reader(self, endpoint: Endpoint) -> bool:
        """See `Transport`."""
        require_open(self.closed, "query", endpoint.name)
        with self._bus.lock:
            own = [writer for writer in self._bus.writers[endpoint.name] if writer.owner is self]
            return any(reader.matches(writer.endpoint) for writer in own for reader in self._bus.readers[endpoint.name])

    def close(self) -> None:
        """See `Transport`."""
        with self._bus.lock:
            self.closed = True
            for readers in self._bus.readers.values():
                readers[:] = [reader for reader in readers if reader.owner is not self]
            for writers in self._bus.writers.values():
                writers[:] = [writer for writer in writers if writer.owner is not self]


class _Stream:
    def __init__(self, endpoint: Endpoint, depth: int, owner: MemoryTransport) -> None:
        self._endpoint, self._owner = endpoint, owner
        self._lock = threading.Lock()  # guards the last two attributes; entered faster than a condition
        self._changed = threading.Condition(self._lock)
        self._newest: deque[bytes] = deque(maxlen=depth)
        self._woken = False

    def put(self, payload: bytes) -> None:
        with self._lock:
            self._newest.append(payload)
            self._changed.notify()

    def take(self) -> list[bytes]:
        require_open(self._owner.closed, "read", self._endpoint.name)
        with self._lock:
            newest = list(self._newest)
            self._newest.clear()
        return newest

    def wait(self, seconds: float) -> bool:
        require_open(self._owner.closed, "read", self._endpoint.name)
        with self._lock:
            triggered = self._changed.wait_for(lambda: self._newest or self._woken, seconds)
            self._woken = False
        return bool(triggered)

    def wake(self) -> None:
        with self._lock:
            self._woken = True
            self._changed.notify()


class _Writer:
    def __init__(self, endpoint: Endpoint, owner: MemoryTransport, bus: MemoryBus) -> None:
        self.endpoint, self.owner = endpoint, owner
        self.latched: bytes | None = None
        self._bus = bus

    def publish(self, payload: bytes) -> None:
        with self._bus.lock:
            require_open(self.owner.closed, "publish on", self.endpoint.name)
            if self.endpoint.qos.latched:
                self.latched = payload
            for reader in list(self._bus.readers[self.endpoint.name]):
                reader.deliver(self.endpoint, payload)


class _Reader:
    def __init__(self, endpoint: Endpoint, callback: Callable[[bytes], None], owner: MemoryTransport) -> None:
        self.endpoint, self.owner = endpoint, owner
        self._callback = callback

    def matches(self, offered: Endpoint) -> bool:
        wanted, qos = self.endpoint.qos, offered.qos
        return not (self.owner.closed or wanted.reliable > qos.reliable or wanted.latched > qos.latched)

    def deliver(self, offered: Endpoint, payload: bytes) -> None:
        if not self.matches(offered):
            return
        try:
            self._callback(payload)
        except Exception:  # must not stop the publisher or other readers
            _log.exception("callback for %s failed", self.endpoint.name)
