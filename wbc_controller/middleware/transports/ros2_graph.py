"""Publishers in ROS 2's graph.

rclpy's own warnings need an event handler per subscription, which on Fast DDS wakes the executor with every message.
"""

import itertools
import logging
import threading
from typing import Any

from rclpy.node import NodeNameNonExistentError
from rclpy.qos import QoSCompatibility, qos_check_compatible

from wbc_controller.middleware.topics import resolve
from wbc_controller.middleware.transports.transport import UNNAMED

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
    compatibility, reasons = qos_check_compatible(info.qos_profile, qos)
    if compatibility != QoSCompatibility.ERROR:
        return ""
    policies = [reason.removeprefix(_ERROR).lower() for reason in reasons.split(";") if reason.startswith(_ERROR)]
    return f"incompatible QoS ({', '.join(policies)}); change the publisher's or qos_overrides.{topic}.subscription"
