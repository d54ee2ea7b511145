"""What can be known of a robot from its URDF's text alone, and the waiting for it on its topic. Knows no Pinocchio."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from wbc_controller.errors import ConfigurationError, valid_choices
from wbc_controller.interface import Topic, endpoints
from wbc_controller.messages import decode
from wbc_controller.records import Array, frozen
from wbc_controller.resources import locate
from wbc_controller.transports.transport import Transport

_log = logging.getLogger(__name__)


def read_urdf(urdf: str) -> str:
    """Read the URDF that a configuration names.

    Args:
        urdf: value of ``robot.urdf``.

    Raises:
        ConfigurationError: where there is none.
    """
    if not urdf:
        raise ConfigurationError(
            "robot.urdf is empty and no URDF came on the topic robot_description; name a file, or publish it latched"
        )
    path: Path = locate(urdf)
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"robot.urdf = {urdf!r}: {path} cannot be read: {error}") from error


def wait_for_urdf(
    transport: Transport,
    stop: threading.Event,
    table: Sequence[Topic],
    node: str,
    namespace: str = "/",
    remappings: Mapping[str, str] | None = None,
) -> str:
    """Wait for the latched URDF, saying so; empty where `stop` was set before it came.

    Args:
        transport: where the topic is opened.
        stop: ends the waiting, within 5 s.
        table: of the node's topics; its row ``robot_description`` is opened.
        node: name of the node.
        namespace: of the node.
        remappings: of topic names.
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


@dataclass(frozen=True, slots=True)
class Description:
    """What a URDF says of the robot and of the joints that are asked for.

    Attributes:
        name: of the robot.
        effort_limits: largest torque of each joint, (na,) in N·m.
    """

    name: str
    effort_limits: Array


def describe(urdf: str, joints: Sequence[str], scale: float) -> Description:
    """Read a URDF's text.

    Args:
        urdf: text of the URDF.
        joints: names, (na,).
        scale: share of the effort limits that may be used.

    Raises:
        ConfigurationError: where the text is no URDF, or a joint or its limit is missing.
    """
    try:
        robot = ElementTree.fromstring(urdf)  # noqa: S314 - the robot's own description, which the controller reads too
    except ElementTree.ParseError as error:
        raise ConfigurationError(f"robot.urdf: not a usable URDF: {error}") from error
    limits = {str(joint.get("name")): joint.find("limit") for joint in robot.findall("joint")}
    values = []
    for name in joints:
        if name not in limits:
            raise ConfigurationError(
                f"robot.joints: {name!r} is not a joint of the URDF; {valid_choices(name, limits)}"
            )
        limit = limits[name]
        text = "" if limit is None else limit.get("effort", "")
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (0.0 < value < math.inf):
            raise ConfigurationError(f"robot.urdf: joint {name!r} has the effort limit {text!r}; it must be positive")
        values.append(scale * value)
    return Description(robot.get("name", ""), frozen(values))
