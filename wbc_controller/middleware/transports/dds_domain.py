"""Domain and discovery of a DDS participant, by ROS 2's environment variables.

The variables have the meaning of ROS 2's table of discovery ranges (Iron and newer):

- On one host, LOCALHOST and SUBNET discover each other in every combination.
- Between hosts, only SUBNET and SUBNET do.

One default differs: without ``ROS_AUTOMATIC_DISCOVERY_RANGE`` the range is LOCALHOST, because every computer on the
network could command the robot otherwise.
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
from wbc_controller.middleware.transports import dds_raw

_log = logging.getLogger(__name__)

#: ROS 2's highest domain: the ports of the next domain would exceed 65535.
MAX_DOMAIN_ID = 232

# RTPS 9.6.1.1: the ports of a domain, and of the n-th participant in it.
_PORT_BASE, _PORTS_PER_DOMAIN, _PORTS_PER_PARTICIPANT, _FIRST_UNICAST_PORT = 7400, 250, 2, 10
_JAZZY_MAX_PARTICIPANT_INDEX = 32

_MULTICAST_OFF = "<AllowMulticast>false</AllowMulticast>"
#: Multicast for announcements only. Cyclone 11 waits for ever when it closes a domain with multicast data and two
#: interfaces: it wakes the thread that receives the data by a packet on the wrong interface.
_MULTICAST_DISCOVERY = "<AllowMulticast>spdp</AllowMulticast>"
#: Interval of the announcements to the peers, for as long as the participant exists. A SUBNET participant on this host
#: announces itself by multicast, which a LOCALHOST participant does not receive: it is discovered by the LOCALHOST
#: participant's next announcement. Cyclone's defaults are 30 s, and none to a port without a participant after 30 s.
_ANNOUNCEMENTS = "<SPDPInterval>1 s</SPDPInterval>"

#: - HeartbeatInterval: time until a packet that a full socket dropped is sent again. Cyclone's default of 100 ms is
#:   fifty control cycles, for a stop beside a flood of large messages.
#: - SocketReceiveBufferSize: the larger, the rarer are dropped packets; the kernel's limit is net.core.rmem_max.
#: - MultipleReceiveThreads: a thread that reads one socket alone saves a system call for each packet.
#: - GenerateKeyhash: Fast DDS removes a closed reader, writer or participant at once only with a key hash, otherwise
#:   when its lease ends after 10 s.
_INTERNAL = (
    '<Internal><HeartbeatInterval>10 ms</HeartbeatInterval><SocketReceiveBufferSize min="0 B" max="16 MiB"/>'
    "<MultipleReceiveThreads>true</MultipleReceiveThreads><GenerateKeyhash>true</GenerateKeyhash></Internal>"
)
#: Fast DDS, vendor 1.15, announces the type of each topic from version 3 on (ROS 2 Kilted), and rmw_fastrtps describes
#: the elements of arrays and sequences with flags that XTypes 1.3 forbids. Cyclone refuses these types, and with them
#: the topics. Without announced types Cyclone compares their names, as with ROS 2's other middleware.
_COMPATIBILITY = "<Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility>"


class DiscoveryRange(str, enum.Enum):
    """Range of a participant's automatic discovery."""

    SUBNET = "SUBNET"
    LOCALHOST = "LOCALHOST"
    OFF = "OFF"
    SYSTEM_DEFAULT = "SYSTEM_DEFAULT"


@dataclass(frozen=True, slots=True)
class DomainSettings:
    """Settings that decide which participants discover each other."""

    domain_id: int  # domain, 0 to 232
    discovery_range: DiscoveryRange
    static_peers: tuple[str, ...] = ()  # addresses of further participants


def domain_settings(
    environment: Mapping[str, str], domain_id: int | None = None, discovery_range: str | None = None
) -> DomainSettings:
    """Read ``ROS_DOMAIN_ID``, ``ROS_AUTOMATIC_DISCOVERY_RANGE``, ``ROS_STATIC_PEERS`` and ``ROS_LOCALHOST_ONLY``.

    Without a range it is ``LOCALHOST``.

    Args:
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
        _log.info("topics stay on this computer; ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET opens them to the network")

    peers = tuple(peer.strip() for peer in environment.get("ROS_STATIC_PEERS", "").split(";") if peer.strip())
    if peers and reach in (DiscoveryRange.OFF, DiscoveryRange.SYSTEM_DEFAULT):
        _log.warning("discovery range is %s: ROS_STATIC_PEERS %s is ignored", reach.value, "; ".join(peers))
        peers = ()
    return DomainSettings(domain_id, reach, peers)


def configuration(settings: DomainSettings, uri: str = "", *, network_card: bool = True) -> str:
    """Write Cyclone's configuration for a domain, as XML.

    `uri` is the content of ``CYCLONEDDS_URI``, appended so that it takes precedence. `network_card` is False on a
    computer without a network interface other than the loopback.
    """
    xml = _xml(settings, own_interfaces=_names_interfaces(uri), network_card=network_card)
    return f"{xml},{uri}" if uri else xml


def _names_interfaces(uri: str) -> bool:
    """Return True if ``CYCLONEDDS_URI``, or a file that it names, selects network interfaces.

    Cyclone adds them to ours, and refuses to start if an interface is selected twice.
    """
    texts = [uri]
    for part in uri.split(","):
        with contextlib.suppress(OSError, ValueError):
            texts.append(Path(part.strip().removeprefix("file://")).read_text(encoding="utf-8"))
    return any(re.search(r"<\s*(\w+:)?NetworkInterface(Address)?\b", text) for text in texts)


def _refuse_security(environment: Mapping[str, str]) -> None:
    """Raise if security is enforced, and warn if it is enabled without being enforced."""
    if environment.get("ROS_SECURITY_ENABLE") != "true":
        return
    if environment.get("ROS_SECURITY_STRATEGY") == "Enforce":
        raise TransportError(
            "ROS_SECURITY_ENABLE is true and ROS_SECURITY_STRATEGY is Enforce, and the embedded DDS cannot secure its "
            "messages; run the ROS 2 executables wbc_controller, mock_robot and guard instead, or unset these variables"
        )
    _log.warning("ROS_SECURITY_ENABLE is true, and the embedded DDS cannot secure its messages: they are open to all")


def _xml(settings: DomainSettings, *, own_interfaces: bool = False, network_card: bool = True) -> str:
    reach, peers = settings.discovery_range, settings.static_peers
    if reach is DiscoveryRange.SYSTEM_DEFAULT:
        return f'<CycloneDDS><Domain Id="any">{_COMPATIBILITY}</Domain></CycloneDDS>'
    if reach is DiscoveryRange.OFF:
        # A unique tag: participants with different tags ignore each other.
        general = _MULTICAST_OFF
        discovery = f"<ParticipantIndex>none</ParticipantIndex><Tag>ros_discovery_off_{os.getpid()}</Tag>"
    else:
        general = _MULTICAST_DISCOVERY if reach is DiscoveryRange.SUBNET else _MULTICAST_OFF
        if not own_interfaces:
            general += _interfaces(network_card and (reach is DiscoveryRange.SUBNET or bool(peers)))
        # Discovery contacts every index of a peer, each a port: many on the loopback, elsewhere as few as Jazzy.
        largest = _JAZZY_MAX_PARTICIPANT_INDEX if peers else _max_participant_index(settings.domain_id)
        addresses = "".join(f'<Peer Address={quoteattr(peer)} PruneDelay="inf"/>' for peer in ("localhost", *peers))
        discovery = (
            f"<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>{largest}</MaxAutoParticipantIndex>"
            f"<Peers>{addresses}</Peers>{_ANNOUNCEMENTS}"
        )
    return (
        f'<CycloneDDS><Domain Id="any"><General>{general}</General>'
        f"<Discovery>{discovery}</Discovery>{_INTERNAL}{_COMPATIBILITY}</Domain></CycloneDDS>"
    )


def _interfaces(network_card: bool) -> str:
    """Select the loopback, and the network card of Cyclone's choice if asked for.

    Cyclone 11 ignores announcements that arrive on an interface that it has not selected. Without the loopback, it
    would not discover LOCALHOST participants of this host; without the network card, it discovers no other host.
    """
    card = '<NetworkInterface autodetermine="true"/>' if network_card else ""
    return f'<Interfaces>{card}<NetworkInterface address="127.0.0.1" multicast="false"/></Interfaces>'


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
    uri = os.environ.get("CYCLONEDDS_URI", "")
    # The configuration without a network card is for a computer that has none: there, Cyclone's choice is the loopback,
    # and the first configuration selects it twice, which is an error.
    first, fallback = (configuration(settings, uri, network_card=card) for card in (True, False))
    try:
        return Domain(settings.domain_id, first)
    except (DDSException, UnicodeEncodeError) as error:
        failure = TransportError(f"cannot open DDS domain {settings.domain_id} ({error}) with {first}")
    if first == fallback:
        raise failure
    try:
        domain = Domain(settings.domain_id, fallback)
    except (DDSException, UnicodeEncodeError):
        raise failure from None
    _log.warning("no network interface but the loopback: topics stay on this computer")
    return domain
