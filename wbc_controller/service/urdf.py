"""Waiting for a URDF that is published on a topic."""

from __future__ import annotations

import logging
import threading
from collections.abc import Mapping, Sequence

from wbc_controller.transports.transport import Transport
from wbc_controller.wire.messages import decode
from wbc_controller.wire.topics import Topic, endpoints

_log = logging.getLogger(__name__)


def wait_for_urdf(
    transport: Transport,
    stop: threading.Event,
    table: Sequence[Topic],
    node: str,
    namespace: str = "/",
    remappings: Mapping[str, str] | None = None,
) -> str:
    """Wait for the latched URDF, with a warning every 5 s; empty if `stop` is set before it arrives.

    Args:
        transport: transport on which the topic is opened.
        stop: event that ends the wait, within 5 s.
        table: the node's topics, of which the row ``robot_description`` is opened.
        node: name of the node.
        namespace: namespace of the node.
        remappings: topic remappings, from name to name.
    """
    arrived = threading.Event()
    payloads: list[bytes] = []

    def receive(payload: bytes) -> None:
        payloads.append(payload)
        arrived.set()

    row = [topic for topic in table if topic.key == "robot_description"]
    (endpoint,) = endpoints(row, node, namespace=namespace, remappings=remappings)
    transport.subscribe(endpoint, receive)
    while not arrived.wait(5.0 if not stop.is_set() else 0.0):
        if stop.is_set():
            return ""
        _log.warning("robot.urdf is empty: still waiting for the URDF on %s", endpoint.name)
    return str(decode(payloads[-1], endpoint.type).data)
