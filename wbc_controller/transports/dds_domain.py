"""Domain and discovery of a DDS participant, by ROS 2's environment variables.

They are read as Jazzy's rmw_cyclonedds reads them, with one difference: without a range it is the loopback, because
everybody on the network could command the robot.
"""

from __future__ import annotations

import contextlib
import enum
import logging
import os
import re
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

from cyclonedds.core import DDSException
from cyclonedds.domain import Domain

from wbc_controller.errors import TransportError, valid_choices
from wbc_controller.transports import dds_raw

_log = logging.getLogger(__name__)

#: ROS 2's highest domain: the ports of the next domain would exceed 65535.
MAX_DOMAIN_ID = 232

# RTPS 9.6.1.1: the ports of a domain, and of the n-th participant in it.
_PORT_BASE, _PORTS_PER_DOMAIN, _PORTS_PER_PARTICIPANT, _FIRST_UNICAST_PORT = 7400, 250, 2, 10
_JAZZY_MAX_PARTICIPANT_INDEX = 32

#: A packet that a full socket dropped is sent again after the writer's heartbeat interval, by default 100 ms: fifty
#: control cycles, for a stop beside a flood of large messages. And the larger the socket's buffer (the kernel's own
#: limit allowing, net.core.rmem_max), the rarer that is. A thread that reads one socket alone need not ask first which
#: of several has something: a system call less for each packet.
_INTERNAL = (
    '<Internal><HeartbeatInterval>10 ms</HeartbeatInterval><SocketReceiveBufferSize min="0 B" max="16 MiB"/>'
    "<MultipleReceiveThreads>true</MultipleReceiveThreads></Internal>"
)


class DiscoveryRange(str, enum.Enum):
    """Range of a participant's automatic discovery."""

    SUBNET = "SUBNET"
    LOCALHOST = "LOCALHOST"
    OFF = "OFF"
    SYSTEM_DEFAULT = "SYSTEM_DEFAULT"


@dataclass(frozen=True, slots=True)
class DomainSettings:
    """Settings that decide which participants discover each other.

    Attributes:
        domain_id: domain, 0 to 232.
        discovery_range: range of the automatic discovery.
        static_peers: addresses of further participants.
    """

    domain_id: int
    discovery_range: DiscoveryRange
    static_peers: tuple[str, ...] = ()


def domain_settings(
    environment: Mapping[str, str], domain_id: int | None = None, discovery_range: str | None = None
) -> DomainSettings:
    """Read ``ROS_DOMAIN_ID``, ``ROS_AUTOMATIC_DISCOVERY_RANGE``, ``ROS_STATIC_PEERS`` and ``ROS_LOCALHOST_ONLY``.

    Without a range it is ``LOCALHOST``.

    Args:
        environment: the environment variables.
        domain_id: overrides the domain of the environment.
        discovery_range: overrides the range of the environment.

    Raises:
        TransportError: if a value is not valid, or security is enforced.
    """
    _refuse_security(environment)
    if domain_id is None:
        domain_id = _domain_id(environment.get("ROS_DOMAIN_ID", ""), "ROS_DOMAIN_ID")
    elif not 0 <= domain_id <= MAX_DOMAIN_ID:
        raise TransportError(f"domain {domain_id} is not valid. Valid: 0 to {MAX_DOMAIN_ID}")

    if discovery_range is not None:
        reach = _discovery_range(discovery_range, "discovery range")
    elif environment.get("ROS_LOCALHOST_ONLY") == "1":  # the older variable takes precedence, without peers
        return DomainSettings(domain_id, DiscoveryRange.LOCALHOST)
    else:
        reach = _discovery_range(
            environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE") or "LOCALHOST", "ROS_AUTOMATIC_DISCOVERY_RANGE"
        )

    if reach is DiscoveryRange.LOCALHOST and discovery_range is None:
        _log.info("topics are on this computer alone; ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET opens them to the network")

    peers = tuple(peer.strip() for peer in environment.get("ROS_STATIC_PEERS", "").split(";") if peer.strip())
    if peers and reach in (DiscoveryRange.OFF, DiscoveryRange.SYSTEM_DEFAULT):
        _log.warning("discovery range is %s: ROS_STATIC_PEERS %s is ignored", reach.value, "; ".join(peers))
        peers = ()
    return DomainSettings(domain_id, reach, peers)


def configuration(settings: DomainSettings, uri: str = "") -> str:
    """Write Cyclone's configuration for a domain.

    Args:
        settings: domain and discovery.
        uri: content of ``CYCLONEDDS_URI``, appended so that it takes precedence.

    Returns:
        XML, followed by `uri`.
    """
    parts = [_xml(settings, own_interfaces=_names_interfaces(uri)), uri]
    return ",".join(part for part in parts if part)


def _names_interfaces(uri: str) -> bool:
    """Whether ``CYCLONEDDS_URI``, or a file that it names, chooses network interfaces.

    Cyclone adds them to ours, and refuses to start if one of them is the loopback too.
    """
    texts = [uri]
    for part in uri.split(","):
        with contextlib.suppress(OSError, ValueError):
            texts.append(Path(part.strip().removeprefix("file://")).read_text(encoding="utf-8"))
    return any(re.search(r"<\s*(\w+:)?NetworkInterface(Address)?\b", text) for text in texts)


def _refuse_security(environment: Mapping[str, str]) -> None:
    """Refuse to run unsecured where security is enforced; say so where it is only wished for."""
    if environment.get("ROS_SECURITY_ENABLE") != "true":
        return
    if environment.get("ROS_SECURITY_STRATEGY") == "Enforce":
        raise TransportError(
            "ROS_SECURITY_ENABLE is true and ROS_SECURITY_STRATEGY is Enforce, and the embedded DDS cannot secure its "
            "messages; run the ROS 2 executables wbc_controller, mock_robot and guard instead, or unset these variables"
        )
    _log.warning("ROS_SECURITY_ENABLE is true, and the embedded DDS cannot secure its messages: they are open to all")


def _xml(settings: DomainSettings, *, own_interfaces: bool = False) -> str:
    reach, peers = settings.discovery_range, settings.static_peers
    if reach is DiscoveryRange.SYSTEM_DEFAULT:
        return ""
    general = "" if reach is DiscoveryRange.SUBNET else "<AllowMulticast>false</AllowMulticast>"
    if reach is DiscoveryRange.OFF:
        # A unique tag: participants with different tags ignore each other.
        discovery = f"<ParticipantIndex>none</ParticipantIndex><Tag>ros_discovery_off_{os.getpid()}</Tag>"
    else:
        # Discovery contacts every index of a peer, each a port: many on the loopback, elsewhere as few as Jazzy.
        alone = reach is DiscoveryRange.LOCALHOST and not peers
        largest = _max_participant_index(settings.domain_id) if alone else _JAZZY_MAX_PARTICIPANT_INDEX
        discovery = (
            f"<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>{largest}</MaxAutoParticipantIndex>"
        )
    if reach is DiscoveryRange.LOCALHOST:
        peers = ("localhost", *peers)
    if reach is DiscoveryRange.LOCALHOST and not own_interfaces:
        # Jazzy does not choose an interface, and participants of its Cyclone (0.10) then still discover each other.
        # This Cyclone (11.0) takes the first network card, where Jazzy does not find it; on the loopback it does
        # (measured).
        network_card = '<NetworkInterface autodetermine="true"/>' if settings.static_peers else ""
        general += f'<Interfaces><NetworkInterface address="127.0.0.1" multicast="false"/>{network_card}</Interfaces>'
    if peers:
        discovery += f"<Peers>{''.join(f'<Peer Address={quoteattr(peer)}/>' for peer in peers)}</Peers>"
    return (
        f'<CycloneDDS><Domain Id="any"><General>{general}</General>'
        f"<Discovery>{discovery}</Discovery>{_INTERNAL}</Domain></CycloneDDS>"
    )


def _max_participant_index(domain_id: int) -> int:
    first = _PORT_BASE + _PORTS_PER_DOMAIN * domain_id + _FIRST_UNICAST_PORT
    last = min(first - _FIRST_UNICAST_PORT + _PORTS_PER_DOMAIN - 1, 65535)
    return (last - first - 1) // _PORTS_PER_PARTICIPANT


def _domain_id(text: str, source: str) -> int:
    if not text:
        return 0
    if not (text.isascii() and text.isdigit() and int(text) <= MAX_DOMAIN_ID):
        raise TransportError(f"{source} is {text!r}. Valid: a whole number from 0 to {MAX_DOMAIN_ID}")
    return int(text)


def _discovery_range(text: str, source: str) -> DiscoveryRange:
    if text not in DiscoveryRange.__members__:
        raise TransportError(f"{source} is {text!r}: {valid_choices(text, DiscoveryRange.__members__)}")
    return DiscoveryRange[text]


@dataclass(slots=True)
class _Open:
    settings: DomainSettings
    domain: Any
    users: int


_open: dict[int, _Open] = {}
_open_lock = threading.Lock()


def open_domain(settings: DomainSettings) -> None:
    """Open a domain, or share it if it is already open, as a process can create each domain only once.

    Raises:
        TransportError: if the domain cannot be opened, or is open in this process with other settings.
    """
    with _open_lock:
        known = _open.get(settings.domain_id)
        if known is None:
            _open[settings.domain_id] = _Open(settings, _create(settings), users=1)
        elif known.settings == settings:
            known.users += 1
        else:
            raise TransportError(
                f"domain {settings.domain_id} is open in this process with other settings: {known.settings}, "
                f"not {settings}"
            )


def close_domain(settings: DomainSettings) -> None:
    """Release a domain opened by `open_domain`; the last user's release closes it."""
    with _open_lock:
        known = _open[settings.domain_id]
        known.users -= 1
        if known.users == 0:
            del _open[settings.domain_id]
            dds_raw.delete(known.domain)


def _create(settings: DomainSettings) -> Any:
    config = configuration(settings, os.environ.get("CYCLONEDDS_URI", ""))
    try:
        return Domain(settings.domain_id, config)
    except (DDSException, UnicodeEncodeError) as error:
        raise TransportError(f"cannot open DDS domain {settings.domain_id} ({error}) with {config}") from error
