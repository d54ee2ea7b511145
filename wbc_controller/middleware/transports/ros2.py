"""Transport on a ROS 2 node."""

import contextlib
import dataclasses
import importlib.util
import logging
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from wbc_controller.errors import TransportError
from wbc_controller.middleware.topics import Endpoint, Qos
from wbc_controller.middleware.transports.ros2_graph import CompatibilityWatch, publisher_names
from wbc_controller.middleware.transports.ros2_reader import RawStream, Reader, ReaderGroup
from wbc_controller.middleware.transports.transport import Publish, check_opening, require_open, translated_errors

_log = logging.getLogger(__name__)

_DRAIN_TIME = 0.5  # timeout for the last messages to reliable readers, s
_OPTIONAL_PACKAGES = ("tf2_msgs",)  # message packages without wheels on PyPI


class Ros2Transport:
    """Topics with serialized messages on an existing node, in all lifecycle states.

    Callbacks run one at a time on the transport's thread (`Reader`). Node parameters ``qos_overrides.<topic>.…``
    override the quality of service. Topics of missing optional packages are not published.
    """

    discovery_time = 1.5  # 1.1 s between Fast DDS and Cyclone

    def __init__(self, node: Any) -> None:
        self._node = node
        self._group = ReaderGroup()
        self._reader = Reader(node.context)
        self._compatibility = CompatibilityWatch(node)
        # Re-entrant, because callbacks may publish, open topics, or close the transport.
        self._lock = threading.RLock()
        self._closed = False
        self._types: dict[str, str] = {}  # by topic
        self._publishers: defaultdict[str, list[Any]] = defaultdict(list)  # by topic
        self._subscriptions: list[Any] = []
        self._streams: list[RawStream] = []

    def advertise(self, endpoint: Endpoint) -> Publish:
        """See `Transport`."""
        package = endpoint.type.split("/")[0]
        if package in _OPTIONAL_PACKAGES and importlib.util.find_spec(package) is None:
            _log.warning("%s is not published: the package %s is not installed", endpoint.name, package)
            return lambda payload: None
        with self._lock:
            message_class = self._check(endpoint)
            with _translated(f"cannot advertise {endpoint.name}"):
                publisher = self._node.create_publisher(
                    message_class,
                    endpoint.name,
                    _profile(endpoint.qos),
                    qos_overriding_options=QoSOverridingOptions.with_default_policies(),
                )
            self._publishers[endpoint.name].append(publisher)

        def publish(payload: bytes) -> None:
            with _translated(f"cannot publish on {endpoint.name}"):
                publisher.publish(payload)

        return publish

    def subscribe(self, endpoint: Endpoint, callback: Callable[[bytes], None]) -> None:
        """See `Transport`."""

        def deliver(payload: bytes) -> None:
            with self._lock:
                if self._closed:
                    return
                try:
                    callback(payload)
                except Exception:  # must not stop the reader of all topics
                    _log.exception("callback for %s failed", endpoint.name)

        self._reader.add(self._subscription(endpoint), deliver)

    def _subscription(self, endpoint: Endpoint) -> Any:
        with self._lock:
            message_class = self._check(endpoint)
            with _translated(f"cannot subscribe to {endpoint.name}"):
                subscription = self._node.create_subscription(
                    message_class,
                    endpoint.name,
                    lambda message: None,  # unused
                    _profile(endpoint.qos),
                    callback_group=self._group,
                    # On Fast DDS the default event handlers wake the executor with each message.
                    event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
                    qos_overriding_options=QoSOverridingOptions.with_default_policies(),
                    raw=True,
                )
            self._subscriptions.append(subscription)
            self._compatibility.add(subscription, endpoint.type)
            return subscription

    def stream(self, endpoint: Endpoint, depth: int) -> RawStream:
        """See `Transport`."""
        endpoint = dataclasses.replace(endpoint, qos=dataclasses.replace(endpoint.qos, depth=depth))
        stream = RawStream(endpoint.name, depth, self._subscription(endpoint), self._node.context)
        self._streams.append(stream)
        return stream

    def publishers(self, endpoint: Endpoint) -> tuple[str, ...]:
        """See `Transport`."""
        with self._lock:
            require_open(self._closed, "query", endpoint.name)
            with _translated(f"cannot query {endpoint.name}"):
                names = publisher_names(self._node, endpoint.name)
        own = self._node.get_fully_qualified_name()
        for _ in range(min(len(self._publishers.get(endpoint.name, ())), names.count(own))):
            names.remove(own)
        return tuple(names)

    def has_reader(self, endpoint: Endpoint) -> bool:
        """See `Transport`."""
        with self._lock:
            require_open(self._closed, "query", endpoint.name)
            return any(publisher.get_subscription_count() for publisher in self._publishers.get(endpoint.name, ()))

    def close(self) -> None:
        """Close all topics, but not the node, after the delivery of the last messages."""
        with self._lock:
            self._closed = True
        for stream in self._streams:
            stream.close()
        self._reader.close()
        self._compatibility.close()
        with self._lock:
            deadline = time.monotonic() + _DRAIN_TIME
            publishers = [publisher for each in self._publishers.values() for publisher in each]
            for publisher in publishers:
                publisher.wait_for_all_acked(Duration(seconds=max(0.0, deadline - time.monotonic())))
            for publisher in publishers:
                self._node.destroy_publisher(publisher)
            for subscription in self._subscriptions:
                self._node.destroy_subscription(subscription)
            self._publishers.clear()
            self._subscriptions = []

    def _check(self, endpoint: Endpoint) -> Any:
        check_opening(self._closed, self._types, endpoint)
        return _message_class(endpoint.type)


def _translated(attempt: str) -> contextlib.AbstractContextManager[None]:
    return translated_errors(attempt, Exception)  # rclpy's errors have no common base class


def _message_class(type_name: str) -> Any:
    package, kind, name = type_name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), name)
    except (ImportError, AttributeError) as error:
        raise TransportError(f"message type {type_name} is not installed: {error}") from error


def _profile(qos: Qos) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=qos.depth,
        reliability=ReliabilityPolicy.RELIABLE if qos.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if qos.latched else DurabilityPolicy.VOLATILE,
    )
