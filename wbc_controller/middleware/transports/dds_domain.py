"""Domain and discovery by ROS 2's environment variables.

The default differs from ROS 2: LOCALHOST, so that other computers cannot command the robot (docs/ros2.md).
"""

import contextlib
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

from wbc_controller.errors import TransportError, require_known
from wbc_controller.middleware.transports import dds_raw

_log = logging.getLogger(__name__)

MAX_DOMAIN_ID = 232  # highest domain with ports below 65536

# RTPS 9.6.1.1: ports of a domain and of its participants.
_PORT_BASE, _PORTS_PER_DOMAIN, _PORTS_PER_PARTICIPANT, _FIRST_UNICAST_PORT = 7400, 250, 2, 10
_JAZZY_MAX_PARTICIPANT_INDEX = 32

_MULTICAST_OFF = "<AllowMulticast>false</AllowMulticast>"
#: Multicast for announcements only: Cyclone 11 does not close a domain with multicast data on two interfaces.
_MULTICAST_DISCOVERY = "<AllowMulticast>spdp</AllowMulticast>"
#: Interval of announcements (default 30 s): a LOCALHOST participant does not receive the multicast of a SUBNET
#: participant on this host, which discovers it by its next announcement.
_ANNOUNCEMENTS = "<SPDPInterval>1 s</SPDPInterval>"

#: - HeartbeatInterval: delay of the retransmission of dropped packets (default 100 ms, fifty control cycles).
#: - SocketReceiveBufferSize: prevents dropped packets; the kernel's limit is net.core.rmem_max.
#: - MultipleReceiveThreads: saves a system call per packet.
#: - GenerateKeyhash: without it Fast DDS removes closed entities only after their lease of 10 s.
_INTERNAL = (
    '<Internal><HeartbeatInterval>10 ms</HeartbeatInterval><SocketReceiveBufferSize min="0 B" max="16 MiB"/>'
    "<MultipleReceiveThreads>true</MultipleReceiveThreads><GenerateKeyhash>true</GenerateKeyhash></Internal>"
)
#: Fast DDS, vendor 1.15, announces the type of each topic from version 3 on (ROS 2 Kilted), and rmw_fastrtps describes
#: the elements of arrays and sequences with flags that XTypes 1.3 forbids. Cyclone refuses these types, and with them
#: the topics. Without announced types Cyclone compares their names, as with ROS 2's other middleware.
_COMPATIBILITY = "<Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility>"

DISCOVERY_RANGES = ("SUBNET", "LOCALHOST", "OFF", "SYSTEM_DEFAULT")  # ranges of a participant's automatic discovery


@dataclass(frozen=True, slots=True)
class DomainSettings:
    """Settings of the discovery."""

    domain_id: int  # 0 to 232
    discovery_range: str  # one of `DISCOVERY_RANGES`
    static_peers: tuple[str, ...] = ()  # addresses of peers


def domain_settings(
    environment: Mapping[str, str], domain_id: int | None = None, discovery_range: str | None = None
) -> DomainSettings:
    """Read ``ROS_DOMAIN_ID``, ``ROS_AUTOMATIC_DISCOVERY_RANGE``, ``ROS_STATIC_PEERS`` and ``ROS_LOCALHOST_ONLY``.

    The arguments override the environment; the default range is ``LOCALHOST``. Invalid values and enforced security
    raise `TransportError`.
    """
    if environment.get("ROS_SECURITY_ENABLE") == "true":
        if environment.get("ROS_SECURITY_STRATEGY") == "Enforce":
            raise TransportError(
                "ROS_SECURITY_ENABLE is true and ROS_SECURITY_STRATEGY is Enforce, but the embedded DDS does not "
                "support security; run the ROS 2 executables wbc_controller, mock_robot and guard instead, or unset "
                "these variables"
            )
        _log.warning(
            "ROS_SECURITY_ENABLE is true, but the embedded DDS does not support security: messages are not secured"
        )
    if domain_id is None:
        text = environment.get("ROS_DOMAIN_ID") or "0"
        if not (text.isascii() and text.isdigit() and int(text) <= MAX_DOMAIN_ID):
            raise TransportError(f"ROS_DOMAIN_ID is {text!r}; valid: integers from 0 to {MAX_DOMAIN_ID}")
        domain_id = int(text)
    elif not 0 <= domain_id <= MAX_DOMAIN_ID:
        raise TransportError(f"invalid domain {domain_id}; valid: 0 to {MAX_DOMAIN_ID}")

    variable = "ROS_AUTOMATIC_DISCOVERY_RANGE"
    if discovery_range is None and environment.get("ROS_LOCALHOST_ONLY") == "1":  # older, has precedence, without peers
        return DomainSettings(domain_id, "LOCALHOST")
    reach = discovery_range if discovery_range is not None else environment.get(variable) or "LOCALHOST"
    source = variable if discovery_range is None else "discovery range"
    require_known(reach, DISCOVERY_RANGES, f"invalid {source}", error=TransportError)
    if reach == "LOCALHOST" and discovery_range is None:
        _log.info("topics stay on this computer; %s=SUBNET opens them to the network", variable)

    peers = tuple(peer.strip() for peer in environment.get("ROS_STATIC_PEERS", "").split(";") if peer.strip())
    if peers and reach in ("OFF", "SYSTEM_DEFAULT"):
        _log.warning("discovery range %s ignores ROS_STATIC_PEERS %s", reach, "; ".join(peers))
        peers = ()
    return DomainSettings(domain_id, reach, peers)


def configuration(settings: DomainSettings, uri: str = "", *, network_card: bool = True) -> str:
    """Return Cyclone's configuration for a domain as XML.

    `uri` is ``CYCLONEDDS_URI``, appended for precedence; `network_card` is False with only the loopback.
    """
    appended = f",{uri}" if uri else ""
    reach, peers = settings.discovery_range, settings.static_peers
    if reach == "SYSTEM_DEFAULT":
        return f'<CycloneDDS><Domain Id="any">{_COMPATIBILITY}</Domain></CycloneDDS>{appended}'
    if reach == "OFF":
        # Participants with different tags ignore each other.
        general = _MULTICAST_OFF
        discovery = f"<ParticipantIndex>none</ParticipantIndex><Tag>ros_discovery_off_{os.getpid()}</Tag>"
    else:
        general = _MULTICAST_DISCOVERY if reach == "SUBNET" else _MULTICAST_OFF
        if not _names_interfaces(uri):  # the loopback, and with peers Cyclone's choice of network card
            # Cyclone 11 ignores announcements on other interfaces.
            named = network_card and (reach == "SUBNET" or bool(peers))
            card = '<NetworkInterface autodetermine="true"/>' if named else ""
            general += f'<Interfaces>{card}<NetworkInterface address="127.0.0.1" multicast="false"/></Interfaces>'
        # Discovery contacts each index (port) of a peer: many on the loopback, otherwise as in Jazzy.
        first = _PORT_BASE + _PORTS_PER_DOMAIN * settings.domain_id
        ports = min(_PORTS_PER_DOMAIN, 65536 - first) - _FIRST_UNICAST_PORT
        largest = _JAZZY_MAX_PARTICIPANT_INDEX if peers else (ports - 2) // _PORTS_PER_PARTICIPANT
        addresses = "".join(f'<Peer Address={quoteattr(peer)} PruneDelay="inf"/>' for peer in ("localhost", *peers))
        discovery = (
            f"<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>{largest}</MaxAutoParticipantIndex>"
            f"<Peers>{addresses}</Peers>{_ANNOUNCEMENTS}"
        )
    return (
        f'<CycloneDDS><Domain Id="any"><General>{general}</General>'
        f"<Discovery>{discovery}</Discovery>{_INTERNAL}{_COMPATIBILITY}</Domain></CycloneDDS>{appended}"
    )


def _names_interfaces(uri: str) -> bool:
    """Return True if ``CYCLONEDDS_URI`` or its file selects network interfaces; Cyclone refuses duplicates."""
    texts = [uri]
    for part in uri.split(","):
        with contextlib.suppress(OSError, ValueError):
            texts.append(Path(part.strip().removeprefix("file://")).read_text(encoding="utf-8"))
    return any(re.search(r"<\s*(\w+:)?NetworkInterface(Address)?\b", text) for text in texts)


@dataclass(slots=True)
class _OpenDomain:
    settings: DomainSettings
    domain: Any
    users: int


_open: dict[int, _OpenDomain] = {}
_open_lock = threading.Lock()


def open_domain(settings: DomainSettings) -> None:
    """Open or share a domain; raise `TransportError` if the domain cannot be opened, or is open with other settings."""
    with _open_lock:
        known = _open.get(settings.domain_id)
        if known is None:
            _open[settings.domain_id] = _OpenDomain(settings, _create(settings), users=1)
        elif known.settings == settings:
            known.users += 1
        else:
            raise TransportError(
                f"domain {settings.domain_id} is already open in this process with other settings: {known.settings}, "
                f"not {settings}"
            )


def close_domain(settings: DomainSettings) -> None:
    """Release a domain of `open_domain`; the last release closes it."""
    with _open_lock:
        known = _open[settings.domain_id]
        known.users -= 1
        if known.users == 0:
            del _open[settings.domain_id]
            dds_raw.delete(known.domain)


def _create(settings: DomainSettings) -> Any:
    uri = os.environ.get("CYCLONEDDS_URI", "")
    # Without a network card Cyclone's choice is the loopback: the first configuration selects it twice, an error.
    texts = dict.fromkeys(configuration(settings, uri, network_card=card) for card in (True, False))
    failures = []
    for text in texts:
        try:
            domain = Domain(settings.domain_id, text)
        except (DDSException, UnicodeEncodeError) as error:
            failures.append(TransportError(f"cannot open DDS domain {settings.domain_id} ({error}) with {text}"))
            continue
        if failures:
            _log.warning("the loopback is the only network interface: topics stay on this computer")
        return domain
    raise failures[0]
