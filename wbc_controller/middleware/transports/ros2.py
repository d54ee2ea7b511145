"""Transport on a ROS 2 node.

rclpy's own warnings of incompatible publishers need an event handler per subscription, which on Fast DDS wakes the
executor with every message.
"""

import contextlib
import dataclasses
import importlib.util
import itertools
import logging
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

from rclpy import qos as ros_qos
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import NodeNameNonExistentError
from rclpy.qos_overriding_options import QoSOverridingOptions

from wbc_controller.errors import TransportError
from wbc_controller.middleware.topics import Endpoint, Qos, resolve
from wbc_controller.middleware.transports.ros2_reader import RawStream, Reader, ReaderGroup
from wbc_controller.middleware.transports.transport import (
    UNNAMED,
    Publish,
    check_opening,
    require_open,
    translated_errors,
)

_log = logging.getLogger(__name__)

PERIOD = 2.0  # for one check of all topics (0.1 ms each), s
_WARNING_CHECK = 2  # number of the check, because node names arrive after publishers
#: Names that ROS 2 gives the node of an endpoint with an unknown participant.
_UNKNOWN_NAMES = ("_NODE_NAME_UNKNOWN_", "_CREATED_BY_BARE_DDS_APP_")
_ERROR = "ERROR: "  # of incompatible policies in rclpy's reasons


def node_name(info: Any) -> str:
    """Return the fully qualified name of the node of an endpoint, or `UNNAMED`."""
    return UNNAMED if info.node_name in _UNKNOWN_NAMES else resolve("~", info.node_name, info.node_namespace)


def publisher_names(node: Any, topic: str) -> list[str]:
    """Return the node of each publisher on a topic, sorted; `UNNAMED` if unknown.

    Endpoints of CycloneDDS do not announce their participant (RTPS 2.3, 9.6.2.2), as Fast DDS 3 (Kilted) requires:
    rmw_fastrtps knows the topics of their nodes, but not the reverse.
    """
    names = [node_name(info) for info in node.get_publishers_info_by_topic(topic)]
    for name, namespace in node.get_node_names_and_namespaces() if UNNAMED in names else ():
        full_name = resolve("~", name, namespace)
        if UNNAMED in names and full_name not in names and topic in _topics_published_by(node, name, namespace):
            names[names.index(UNNAMED)] = full_name
    return sorted(names)


def _topics_published_by(node: Any, name: str, namespace: str) -> list[str]:
    try:
        return [topic for topic, _ in node.get_publisher_names_and_types_by_node(name, namespace)]
    except NodeNameNonExistentError:  # the node has ended in the meantime
        return []


class CompatibilityWatch:
    """Periodic comparison of subscriptions with their publishers, on a thread."""

    def __init__(self, node: Any) -> None:
        self._node = node
        self._subscriptions: list[tuple[Any, str]] = []  # and message types
        self._checks: dict[str, dict[bytes, int]] = {}  # checks by topic and incompatible publisher
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    def add(self, subscription: Any, message_type: str) -> None:
        """Add a subscription."""
        self._subscriptions.append((subscription, message_type))
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="compatibility", daemon=True)
            self._thread.start()

    def close(self) -> None:
        """Stop the thread."""
        self._ended.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join()

    def _run(self) -> None:
        try:
            for count in itertools.count():
                if self._ended.wait(PERIOD / len(self._subscriptions)):
                    return
                self._check(*self._subscriptions[count % len(self._subscriptions)])
        except Exception:
            if self._node.context.ok():
                _log.exception("the check of publishers for compatible type and quality of service has ended")

    def _check(self, subscription: Any, message_type: str) -> None:
        topic = subscription.topic_name
        before, checks = self._checks.get(topic, {}), {}
        for info in self._node.get_publishers_info_by_topic(topic):
            problem = _problem(info, subscription.qos_profile, message_type, topic)
            if problem:
                publisher = bytes(info.endpoint_gid)
                checks[publisher] = before.get(publisher, 0) + 1
                if checks[publisher] == _WARNING_CHECK:
                    _log.warning("no messages on %s from %s: %s", topic, node_name(info), problem)
        self._checks[topic] = checks


def _problem(info: Any, qos: Any, message_type: str, topic: str) -> str:
    if info.topic_type != message_type:
        return f"type {info.topic_type}; publish {message_type}"
    compatibility, reasons = ros_qos.qos_check_compatible(info.qos_profile, qos)
    if compatibility != ros_qos.QoSCompatibility.ERROR:
        return ""
    policies = [reason.removeprefix(_ERROR).lower() for reason in reasons.split(";") if reason.startswith(_ERROR)]
    return f"incompatible QoS ({', '.join(policies)}); change the publisher's or qos_overrides.{topic}.subscription"


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


def _profile(qos: Qos) -> ros_qos.QoSProfile:
    return ros_qos.QoSProfile(
        history=ros_qos.HistoryPolicy.KEEP_LAST,
        depth=qos.depth,
        reliability=ros_qos.ReliabilityPolicy.RELIABLE if qos.reliable else ros_qos.ReliabilityPolicy.BEST_EFFORT,
        durability=ros_qos.DurabilityPolicy.TRANSIENT_LOCAL if qos.latched else ros_qos.DurabilityPolicy.VOLATILE,
    )
