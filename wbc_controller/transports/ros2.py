"""The same topics on a ROS 2 node. Besides the nodes of ``ros2/``, the one importer of rclpy (7.1, Jazzy, on)."""

from __future__ import annotations

import importlib
import logging
import threading
import time
from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from wbc_controller.errors import TransportError
from wbc_controller.interface import STATE_IN, Endpoint, Qos
from wbc_controller.transports.topic_types import TopicTypes
from wbc_controller.transports.transport import Publish

_log = logging.getLogger(__name__)

#: Longest time, at closing, in which all reliable readers may take what was published last, s.
_LAST_WORDS = 0.5
#: Longest time that a message which is no stream may wait in `StreamsFirstExecutor`, s.
_OTHERS_PERIOD = 0.01


class StreamGroup(MutuallyExclusiveCallbackGroup):  # type: ignore[misc]  # rclpy has no types
    """The callbacks that the control loop waits for: the robot's state, and the commands to the supervisor."""


class StreamsFirstExecutor(SingleThreadedExecutor):  # type: ignore[misc]  # rclpy has no types
    """An executor that a control loop can live with in one Python process.

    rclpy builds its wait set anew before each callback. With the hundred entities of a controller's node that takes
    longer than a control period leaves, and it holds the interpreter lock meanwhile. So this one waits for the
    streams alone, and looks at all the others every `_OTHERS_PERIOD`.
    """

    def __init__(self, *, context: Any = None) -> None:
        super().__init__(context=context)
        self._everything = True
        self._others_due = 0.0

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Do one callback; without a timeout, come back at the latest when the others are due."""
        # Always the same timeout: with another one rclpy begins anew with the coroutines that wait, such as those of
        # services, and comes to nothing else until they end.
        super().spin_once(_OTHERS_PERIOD if timeout_sec is None else timeout_sec)

    def get_nodes(self) -> Any:
        """The nodes; rclpy asks for them just before it gathers what it waits for."""
        now = time.monotonic()
        self._everything = now >= self._others_due
        if self._everything:
            self._others_due = now + _OTHERS_PERIOD
        return super().get_nodes()

    def can_execute(self, entity: Any) -> bool:
        """Whether an entity is to be waited for now."""
        if not (self._everything or isinstance(entity.callback_group, StreamGroup)):
            return False
        return bool(super().can_execute(entity))


class Ros2Transport:
    """Opens its topics on an existing node, plain or lifecycle, that its owner spins.

    Messages stay serialized: no Python message object is made. Callbacks run one at a time, on the threads of the
    executor that spins the node. QoS can be overridden by the node's ``qos_overrides.<topic>.…`` parameters.

    Args:
        node: an ``rclpy.node.Node`` or ``rclpy.lifecycle.LifecycleNode``. A lifecycle node's topics work in all of its
            states: what may be commanded in which state is for the safety supervisor to say.
    """

    def __init__(self, node: Any) -> None:
        self._node = node
        self._streams, self._others = StreamGroup(), MutuallyExclusiveCallbackGroup()
        # Re-entrant, because a callback may publish, open topics, or close the transport.
        self._lock = threading.RLock()
        self._closed = False
        self._types = TopicTypes()
        self._publishers: list[Any] = []
        self._subscriptions: list[Any] = []

    def advertise(self, endpoint: Endpoint) -> Publish:
        """Open a topic for writing."""
        with self._lock:
            message_class = self._check(endpoint)
            try:
                publisher = self._node.create_publisher(
                    message_class,
                    endpoint.name,
                    _profile(endpoint.qos),
                    qos_overriding_options=QoSOverridingOptions.with_default_policies(),
                )
            except Exception as error:  # rclpy has no common base for what it raises here
                raise TransportError(f"cannot advertise {endpoint.name}: {error}") from error
            self._publishers.append(publisher)

        def publish(payload: bytes) -> None:
            try:
                publisher.publish(payload)
            except Exception as error:  # as above
                raise TransportError(f"cannot publish on {endpoint.name}: {error}") from error

        return publish

    def subscribe(self, endpoint: Endpoint, callback: Callable[[bytes], None]) -> None:
        """Open a topic for reading; the callback runs on the executor's thread."""

        def deliver(payload: bytes) -> None:
            with self._lock:
                if self._closed:
                    return
                try:
                    callback(payload)
                except Exception:  # it would end the executor, and with it the node
                    _log.exception("callback for %s failed", endpoint.name)

        with self._lock:
            message_class = self._check(endpoint)
            stream = endpoint.qos == STATE_IN or endpoint.key == "command"
            try:
                subscription = self._node.create_subscription(
                    message_class,
                    endpoint.name,
                    deliver,
                    _profile(endpoint.qos),
                    callback_group=self._streams if stream else self._others,
                    qos_overriding_options=QoSOverridingOptions.with_default_policies(),
                    raw=True,
                )
            except Exception as error:  # as above
                raise TransportError(f"cannot subscribe to {endpoint.name}: {error}") from error
            self._subscriptions.append(subscription)

    def close(self) -> None:
        """Close all topics; the node stays as it is. A second call does nothing.

        What was published last, such as zero torques, is given a moment to arrive at its reliable readers.
        """
        with self._lock:
            self._closed = True
            deadline = time.monotonic() + _LAST_WORDS
            for publisher in self._publishers:
                publisher.wait_for_all_acked(Duration(seconds=max(0.0, deadline - time.monotonic())))
            for publisher in self._publishers:
                self._node.destroy_publisher(publisher)
            for subscription in self._subscriptions:
                self._node.destroy_subscription(subscription)
            self._publishers, self._subscriptions = [], []

    def _check(self, endpoint: Endpoint) -> Any:
        if self._closed:
            raise TransportError(f"cannot open {endpoint.name}: the transport is closed")
        self._types.check(endpoint.name, endpoint.type)
        return _message_class(endpoint.type)


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
