"""The URDF of a service: of a file, or waited for on a topic."""

from __future__ import annotations

import logging
import threading
from collections.abc import Mapping, Sequence

from wbc_controller.controller.build.robot_description import read_urdf
from wbc_controller.errors import InputRefused
from wbc_controller.inverse_dynamics.robot.urdf import LARGEST_URDF
from wbc_controller.middleware.codec import decode
from wbc_controller.middleware.topics import Endpoint, Topic, endpoints
from wbc_controller.middleware.transports.transport import Transport
from wbc_controller.settings import Settings

_log = logging.getLogger(__name__)

#: Longest message, in bytes: a URDF, its length, the end of the string and the padding.
_LARGEST = LARGEST_URDF + 16


def urdf_of(payload: bytes, endpoint: Endpoint) -> str:
    """Read the URDF of a message.

    Args:
        payload: the serialized message.
        endpoint: its topic.

    Raises:
        InputRefused: if it is too long, which is seen before it is decoded, or no message of its type.
    """
    if len(payload) > _LARGEST:
        raise InputRefused(f"{len(payload)} bytes are too long for a URDF; it may have {LARGEST_URDF}")
    return str(decode(payload, endpoint.type).data)


def find_urdf(
    settings: Settings,
    transport: Transport,
    stop: threading.Event,
    table: Sequence[Topic],
    node: str,
    namespace: str = "/",
    remappings: Mapping[str, str] | None = None,
) -> str:
    """The URDF: of the file that the settings name, or else of the topic; empty if `stop` is set before it arrives.

    Args:
        settings: the robot's settings.
        transport: as `wait_for_urdf` takes it, like the rest.
        stop: event that ends the wait.
        table: the node's topics.
        node: name of the node.
        namespace: namespace of the node.
        remappings: topic remappings, from name to name.

    Raises:
        ConfigurationError: if the file cannot be read.
    """
    if settings.robot.urdf:
        return read_urdf(settings.robot.urdf)
    return wait_for_urdf(transport, stop, table, node, namespace, remappings)


def wait_for_urdf(
    transport: Transport,
    stop: threading.Event,
    table: Sequence[Topic],
    node: str,
    namespace: str = "/",
    remappings: Mapping[str, str] | None = None,
) -> str:
    """Wait for the latched URDF, with a warning every 5 s; empty if `stop` is set before it arrives.

    The first usable message counts. One that is too long is refused before it is decoded; the log says so once.

    Args:
        transport: transport on which the topic is opened.
        stop: event that ends the wait, within 5 s.
        table: the node's topics, of which the row ``robot_description`` is opened.
        node: name of the node.
        namespace: namespace of the node.
        remappings: topic remappings, from name to name.
    """
    arrived = threading.Event()
    found, refused = "", False

    def receive(payload: bytes) -> None:
        nonlocal found, refused
        if arrived.is_set():
            return
        try:
            found = urdf_of(payload, endpoint)
        except InputRefused as error:
            if not refused:
                _log.warning("refused %s: %s", endpoint.name, error)
            refused = True
            return
        arrived.set()

    row = [topic for topic in table if topic.key == "robot_description"]
    (endpoint,) = endpoints(row, node, namespace=namespace, remappings=remappings)
    transport.subscribe(endpoint, receive)
    while not arrived.wait(5.0 if not stop.is_set() else 0.0):
        if stop.is_set():
            return ""
        _log.warning("robot.urdf is empty: still waiting for the URDF on %s", endpoint.name)
    return found
