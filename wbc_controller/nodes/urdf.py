"""URDF from file or topic."""

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

_LARGEST = LARGEST_URDF + 16  # bytes: URDF, length, terminator and padding
_WARNING_PERIOD = 5.0  # s


def decode_urdf(payload: bytes, endpoint: Endpoint) -> str:
    """Decode the URDF from a serialized message; raises `InputRefused` if too long or of another type."""
    if len(payload) > _LARGEST:
        raise InputRefused(f"URDF has {len(payload)} bytes (limit {LARGEST_URDF})")
    return str(decode(payload, endpoint.type).data)


def find_urdf(settings: Settings, transport: Transport, stop: threading.Event, topics: Iterable[Endpoint]) -> str:
    """Return the URDF from the file of the settings, or from the topic by `wait_for_urdf`."""
    return read_urdf(settings.robot.urdf) if settings.robot.urdf else wait_for_urdf(transport, stop, topics)


def wait_for_urdf(transport: Transport, stop: threading.Event, topics: Iterable[Endpoint]) -> str:
    """Wait for the first valid URDF on ``robot_description``; return an empty text within 5 s after `stop` was set."""
    (endpoint,) = (topic for topic in topics if topic.key == "robot_description")
    stream, refused = transport.stream(endpoint, 1), False
    while True:
        arrived = stream.wait(_WARNING_PERIOD if not stop.is_set() else 0.0)
        for payload in stream.take():
            try:
                return decode_urdf(payload, endpoint)
            except InputRefused as error:
                if not refused:
                    _log.warning("refused %s: %s", endpoint.name, error)
                refused = True
        if stop.is_set():
            return ""
        if not arrived:
            names = ", ".join(transport.publishers(endpoint))
            latched = f"publisher {names} must be latched (durability transient local), not volatile"
            cause = latched if names else "no publisher"
            _log.warning("robot.urdf is empty: still waiting for the URDF on %s; %s", endpoint.name, cause)
