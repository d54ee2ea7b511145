"""Transport on CycloneDDS, compatible with ROS 2."""

import contextlib
import dataclasses
import logging
import os
import threading
import time
from collections.abc import Callable
from typing import Any

from cyclonedds.core import DDSException, GuardCondition, Policy
from cyclonedds.core import Qos as DdsQos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from wbc_controller.errors import TransportError
from wbc_controller.middleware.topics import Endpoint
from wbc_controller.middleware.transports import dds_raw
from wbc_controller.middleware.transports.dds_domain import close_domain, domain_settings, open_domain
from wbc_controller.middleware.transports.dds_graph import Graph, NodeAnnouncement
from wbc_controller.middleware.transports.dds_types import idl_type, type_hash
from wbc_controller.middleware.transports.transport import check_opening, require_open, translated_errors

_log = logging.getLogger(__name__)

_Callback = Callable[[bytes], None]

#: Longest blocking of a publisher by a full network buffer, ns: cyclonedds holds Python's global lock meanwhile, and a
#: lost message is better than a lost control cycle.
_MAX_BLOCKING_TIME = 10_000_000


class DdsTransport:
    """One node on a DDS domain, with callbacks on one thread.

    The defaults are ``ROS_DOMAIN_ID`` (0 to 232) and ``ROS_AUTOMATIC_DISCOVERY_RANGE`` (one of `DISCOVERY_RANGES`),
    then ``LOCALHOST``. An invalid setting, enforced security, or a failure of DDS raises `TransportError`.
    """

    discovery_time = 1.5  # 1.1 s between Fast DDS and Cyclone

    def __init__(
        self, node: str, namespace: str = "/", domain_id: int | None = None, discovery_range: str | None = None
    ) -> None:
        self._settings = domain_settings(os.environ, domain_id, discovery_range)
        self.domain = self._settings.domain_id
        self._lock = threading.Lock()
        self._closing = threading.Lock()
        self._closed = False
        self._types: dict[str, str] = {}  # by topic
        self._topics: dict[str, Any] = {}
        self._publications: dict[str, list[DdsPublication]] = {}  # by topic
        self._graph: Graph | None = None
        open_domain(self._settings)
        with contextlib.ExitStack() as opened:
            opened.callback(close_domain, self._settings)
            try:
                # ROS 2 requires the name of a security enclave.
                qos = DdsQos(Policy.Userdata(b"enclave=/;"))
                self._participant = DomainParticipant(self.domain, qos)
                opened.callback(dds_raw.delete, self._participant)
                self._announcement = NodeAnnouncement(self._participant, node, namespace)
                opened.callback(self._announcement.delete)
                self._dispatcher = _Dispatcher(self._participant, f"dds {node}")
            except Exception as error:
                raise TransportError(f"cannot join DDS domain {self.domain}: {error}") from error
            self._opened = opened.pop_all()  # deletes its entities, the newest first

    def advertise(self, endpoint: Endpoint) -> "DdsPublication":
        """See `Transport`."""
        with self._lock, _translated(f"cannot advertise {endpoint.name}"):
            writer = DataWriter(self._participant, self._topic(endpoint), _writer_qos(endpoint))
            publication = DdsPublication(endpoint.name, writer)
            self._publications.setdefault(endpoint.name, []).append(publication)
            self._opened.callback(publication.delete)
            self._announcement.add(writer)
            return publication

    def subscribe(self, endpoint: Endpoint, callback: Callable[[bytes], None]) -> None:
        """See `Transport`."""
        with self._lock, _translated(f"cannot subscribe to {endpoint.name}"):
            self._dispatcher.add(endpoint, self._reader(endpoint), callback)

    def stream(self, endpoint: Endpoint, depth: int) -> "_Stream":
        """See `Transport`."""
        endpoint = dataclasses.replace(endpoint, qos=dataclasses.replace(endpoint.qos, depth=depth))
        with self._lock, _translated(f"cannot subscribe to {endpoint.name}"):
            stream = _Stream(endpoint, self._reader(endpoint), self._participant)
            self._opened.callback(stream.delete)
            return stream

    def publishers(self, endpoint: Endpoint) -> tuple[str, ...]:
        """See `Transport`."""
        with self._lock, _translated(f"cannot query {endpoint.name}"):
            require_open(self._closed, "query", endpoint.name)
            if self._graph is None:
                self._graph = Graph(self._participant)
                self._opened.callback(self._graph.delete)
            return self._graph.publishers(_dds_name(endpoint))

    def has_reader(self, endpoint: Endpoint) -> bool:
        """See `Transport`."""
        with _translated(f"cannot query {endpoint.name}"):  # without the lock, which would block the loop
            require_open(self._closed, "query", endpoint.name)
            return any(each.has_reader for each in self._publications.get(endpoint.name, ()))

    def close(self) -> None:
        """See `Transport`; a call from a callback raises `TransportError`."""
        if threading.current_thread() is self._dispatcher.thread:
            raise TransportError("close() was called from a callback: it would wait forever for the callback's end")
        with self._closing:
            with self._lock:
                if self._closed:
                    return
                self._closed = True
            # Without `_lock`: `stop` waits for a callback, which may open a topic.
            self._dispatcher.stop()
            self._opened.close()

    def _reader(self, endpoint: Endpoint) -> Any:
        reader = DataReader(self._participant, self._topic(endpoint), _reader_qos(endpoint))
        self._opened.callback(dds_raw.delete, reader)
        self._announcement.add(reader)
        return reader

    def _topic(self, endpoint: Endpoint) -> Any:
        check_opening(self._closed, self._types, endpoint)
        if endpoint.name not in self._topics:
            topic = Topic(self._participant, _dds_name(endpoint), idl_type(endpoint.type))
            self._topics[endpoint.name] = topic
            self._opened.callback(dds_raw.delete, topic)
        return self._topics[endpoint.name]


def _translated(attempt: str) -> contextlib.AbstractContextManager[None]:
    return translated_errors(attempt, DDSException, ValueError)


class DdsPublication:
    """Thread-safe publisher on one topic."""

    def __init__(self, topic: str, writer: Any) -> None:
        self.topic = topic
        self._writer = writer
        self._closed = False

    def __call__(self, payload: bytes) -> None:
        """Send one serialized message."""
        require_open(self._closed, "publish on", self.topic)
        with _translated(f"cannot publish on {self.topic}"):
            dds_raw.write(self._writer, payload)

    @property
    def has_reader(self) -> bool:
        """True if the topic has a reader."""
        return bool(self._writer.get_matched_subscriptions())

    def wait_for_reader(self, patience: float) -> bool:
        """Wait for a reader, at most `patience` seconds; return True if there is one."""
        deadline = time.monotonic() + patience
        while not self.has_reader:
            if time.monotonic() >= deadline:
                return False
            time.sleep(0.005)
        return True

    def wait_for_acknowledgment(self, patience: float) -> bool:
        """Wait for the acknowledgment of all readers, at most `patience` seconds; return True if it arrived."""
        with _translated(f"cannot publish on {self.topic}"):
            return bool(self._writer.wait_for_acks(round(1e9 * patience)))

    def delete(self) -> None:
        """Delete the writer."""
        self._closed = True
        dds_raw.delete(self._writer)


class _Stream:
    """Reader with messages taken by hand, and a wait without the interpreter's lock."""

    def __init__(self, endpoint: Endpoint, reader: Any, participant: Any) -> None:
        self._endpoint, self._reader = endpoint, reader
        self._guard = GuardCondition(participant)
        self._triggers = dds_raw.Triggers(participant)
        self._triggers.attach(self._guard)
        self._triggers.attach_reader(reader)
        self._woken = self._closed = False

    def take(self) -> list[bytes]:
        require_open(self._closed, "read", self._endpoint.name)
        with _translated(f"cannot read {self._endpoint.name}"):
            return dds_raw.take(self._reader, self._endpoint.qos.depth)

    def wait(self, seconds: float) -> bool:
        require_open(self._closed, "read", self._endpoint.name)
        with _translated(f"cannot wait for {self._endpoint.name}"):
            triggered = self._triggers.wait(seconds)
            if self._woken:
                self._woken = False
                self._guard.take()
            return triggered

    def wake(self) -> None:
        if not self._closed:
            self._guard.set(True)
            self._woken = True  # after the guard, so that a set guard is always reset

    def delete(self) -> None:
        self.wake()
        self._closed = True
        self._triggers.delete()


class _Dispatcher:
    def __init__(self, participant: Any, name: str) -> None:
        self._triggers = dds_raw.Triggers(participant)
        self._stop = GuardCondition(participant)
        self._stop_number = self._triggers.attach(self._stop)
        self._readers: dict[int, tuple[Endpoint, Any, _Callback]] = {}
        self._adding = threading.Lock()
        self.thread = threading.Thread(target=self._run, name=name, daemon=True)
        self.thread.start()

    def add(self, endpoint: Endpoint, reader: Any, callback: _Callback) -> None:
        with self._adding:
            self._readers[self._triggers.attach_reader(reader)] = (endpoint, reader, callback)

    def stop(self) -> None:
        self._stop.set(True)
        self.thread.join()
        self._triggers.delete()

    def _run(self) -> None:
        try:
            numbers: list[int] = []
            while self._stop_number not in numbers:
                for number in numbers:
                    self._dispatch(number)
                self._triggers.wait()
                numbers = self._triggers.triggered()
        except Exception:
            _log.exception("the DDS reader thread failed: no more messages will arrive")

    def _dispatch(self, number: int) -> None:
        with self._adding:  # a new reader may trigger before its registration
            endpoint, reader, callback = self._readers[number]
        for payload in dds_raw.take(reader, endpoint.qos.depth):
            try:
                callback(payload)
            except Exception:  # must not stop other messages
                _log.exception("callback for %s failed", endpoint.name)


def _dds_name(endpoint: Endpoint) -> str:
    return f"rt{endpoint.name}"


def _reader_qos(endpoint: Endpoint) -> Any:
    qos = endpoint.qos
    return DdsQos(
        Policy.Reliability.Reliable(_MAX_BLOCKING_TIME) if qos.reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if qos.latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(qos.depth),
        Policy.DataRepresentation(use_cdrv0_representation=True),
        Policy.Userdata(f"typehash={type_hash(endpoint.type)};".encode()),
    )


def _writer_qos(endpoint: Endpoint) -> Any:
    history, unlimited = Policy.History.KeepLast(endpoint.qos.depth), -1
    return DdsQos(
        # Cyclone has separate histories for late readers and for retransmission.
        Policy.DurabilityService(0, history, unlimited, unlimited, unlimited),
        Policy.WriterDataLifecycle(autodispose=False),
        base=_reader_qos(endpoint),
    )
