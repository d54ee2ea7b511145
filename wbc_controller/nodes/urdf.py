"""The URDF of a node: read from a file, or received on a topic."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterable

from wbc_controller.controller.build.robot_description import read_urdf
from wbc_controller.errors import InputRefused
from wbc_controller.inverse_dynamics.robot.urdf import LARGEST_URDF
from wbc_controller.middleware.codec import decode
from wbc_controller.middleware.topics import Endpoint
from wbc_controller.middleware.transports.transport import Transport
from wbc_controller.settings import Settings

_log = logging.getLogger(__name__)

#: Longest message, in bytes: a URDF, its length, the end of the string and the padding.
_LARGEST = LARGEST_URDF + 16

#: Time between two warnings, s.
_PATIENCE = 5.0


def urdf_of(payload: bytes, endpoint: Endpoint) -> str:
    """Read the URDF of a serialized message on a topic.

    Raises:
        InputRefused: if it is too long, which is checked before it is decoded, or no message of its type.
    """
    if len(payload) > _LARGEST:
        raise InputRefused(f"{len(payload)} bytes are too long for a URDF; it may have {LARGEST_URDF}")
    return str(decode(payload, endpoint.type).data)


def find_urdf(settings: Settings, transport: Transport, stop: threading.Event, topics: Iterable[Endpoint]) -> str:
    """Read the URDF from the file in the settings, or wait for it as `wait_for_urdf` does.

    Raises:
        ConfigurationError: if the file cannot be read.
    """
    return read_urdf(settings.robot.urdf) if settings.robot.urdf else wait_for_urdf(transport, stop, topics)


def wait_for_urdf(transport: Transport, stop: threading.Event, topics: Iterable[Endpoint]) -> str:
    """Wait for the latched URDF on the topic ``robot_description``, with a warning every 5 s.

    The first usable message counts. The log reports the first message that is refused.

    Returns:
        The URDF; empty if `stop` is set before it arrives, which is noticed within 5 s.
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

    (endpoint,) = (topic for topic in topics if topic.key == "robot_description")
    transport.subscribe(endpoint, receive)
    while not arrived.wait(_PATIENCE if not stop.is_set() else 0.0):
        if stop.is_set():
            return ""
        _log.warning(
            "robot.urdf is empty: still waiting for the URDF on %s; %s", endpoint.name, _cause(transport, endpoint)
        )
    return found


def _cause(transport: Transport, endpoint: Endpoint) -> str:
    """Return the probable reason why no message of a latched topic has arrived."""
    names = transport.publishers(endpoint)
    if not names:
        return "it has no publisher"
    return (
        f"{', '.join(names)} publishes it, but nothing arrives: the publisher has to be latched (durability transient "
        "local), not volatile"
    )
