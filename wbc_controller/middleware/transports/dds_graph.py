"""Node names of DDS readers and writers."""

import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import Policy, Qos
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from wbc_controller.errors import InputRefused
from wbc_controller.middleware.codec import decode, encode, message
from wbc_controller.middleware.transports import dds_raw
from wbc_controller.middleware.transports.dds_types import idl_type, type_hash
from wbc_controller.middleware.transports.transport import UNNAMED

_TYPE = "rmw_dds_common/msg/ParticipantEntitiesInfo"
_DISCOVERY = "ros_discovery_info"
_HEADER, _GID = 4, 16  # bytes of header and participant in an announcement
_ANNOUNCEMENTS = 1000  # queue length: a starting controller sends one for each of its 150 endpoints
_CHANGES = 10_000  # graph changes per update


class NodeAnnouncement:
    """Announcement of the node of a participant's readers and writers."""

    def __init__(self, participant: Any, node: str, namespace: str) -> None:
        self._participant_gid = _gid(participant)
        self._node = {"node_namespace": namespace, "node_name": node}
        self._gids: dict[str, list[Any]] = {"reader_gid_seq": [], "writer_gid_seq": []}
        qos = Qos(
            Policy.Reliability.Reliable(max_blocking_time=0),
            Policy.Durability.TransientLocal,
            Policy.History.KeepLast(1),
            Policy.WriterDataLifecycle(autodispose=False),
            Policy.DataRepresentation(use_cdrv0_representation=True),
            Policy.Userdata(f"typehash={type_hash(_TYPE)};".encode()),
        )
        self._topic = Topic(participant, _DISCOVERY, idl_type(_TYPE))
        self._writer = DataWriter(participant, self._topic, qos)
        self._publish()

    def add(self, entity: DataReader | DataWriter) -> None:
        """Announce a reader or writer."""
        self._gids["writer_gid_seq" if isinstance(entity, DataWriter) else "reader_gid_seq"].append(_gid(entity))
        self._publish()

    def delete(self) -> None:
        """Delete the announcement's own entities."""
        dds_raw.delete(self._writer)
        dds_raw.delete(self._topic)

    def _publish(self) -> None:
        node = message("rmw_dds_common/msg/NodeEntitiesInfo", **self._node, **self._gids)
        announcement = message(_TYPE, gid=self._participant_gid, node_entities_info_seq=[node])
        dds_raw.write(self._writer, encode(announcement))


class Graph:
    """Writers of a domain with their node names; updated on demand (60 µs)."""

    def __init__(self, participant: Any) -> None:
        self._own = participant.guid.bytes
        self._lock = threading.Lock()
        self._writers: dict[bytes, tuple[bytes, str]] = {}  # participant and topic by GUID
        self._announced: dict[bytes, bytes] = {}  # by participant: the newest announcement, serialized
        self._names: dict[bytes, tuple[bytes, dict[bytes, str]]] = {}  # by participant: announcement and its names
        self._changes = BuiltinDataReader(participant, BuiltinTopicDcpsPublication)
        qos = Qos(
            Policy.Reliability.Reliable(max_blocking_time=0),
            Policy.Durability.TransientLocal,
            Policy.History.KeepLast(_ANNOUNCEMENTS),
        )
        self._topic = Topic(participant, _DISCOVERY, idl_type(_TYPE))
        self._announcements = DataReader(participant, self._topic, qos)

    def publishers(self, topic: str) -> tuple[str, ...]:
        """Return the sorted nodes (or `UNNAMED`) of a topic's writers in other participants; raise `DDSException`."""
        with self._lock:
            self._update()
            writers = [(owner, guid) for guid, (owner, name) in self._writers.items() if name == topic]
            return tuple(sorted(self._name(owner, guid) for owner, guid in writers if owner != self._own))

    def delete(self) -> None:
        """Delete the readers."""
        for entity in (self._announcements, self._topic, self._changes):
            dds_raw.delete(entity)

    def _update(self) -> None:
        """Read the changes. Writers arrive before their announcements; announcements without writers are dropped."""
        for payload in dds_raw.take(self._announcements, _ANNOUNCEMENTS):
            self._announced[payload[_HEADER : _HEADER + _GID]] = payload
        for guid, owner, topic in dds_raw.take_writers(self._changes, _CHANGES):
            if topic is None:
                self._writers.pop(guid, None)
            else:
                self._writers[guid] = owner, topic
        present = {owner for owner, topic in self._writers.values() if topic == _DISCOVERY}
        self._announced = {owner: payload for owner, payload in self._announced.items() if owner in present}
        self._names = {owner: names for owner, names in self._names.items() if owner in present}

    def _name(self, owner: bytes, writer: bytes) -> str:
        payload = self._announced.get(owner, b"")
        if self._names.get(owner, (None,))[0] != payload:
            self._names[owner] = payload, dict(_announced_writers(payload))
        return self._names[owner][1].get(writer, UNNAMED)


def _announced_writers(payload: bytes) -> Iterator[tuple[bytes, str]]:
    try:
        announcement = decode(payload, _TYPE)
    except InputRefused:  # not a ROS 2 node
        return
    for node in announcement.node_entities_info_seq:
        name = f"{node.node_namespace.rstrip('/')}/{node.node_name}"
        for gid in node.writer_gid_seq:
            yield bytes(gid.data), name


def _gid(entity: Any) -> Any:
    """Return ROS 2's identifier of a DDS entity: the sixteen bytes of its GUID (Jazzy)."""
    return message("rmw_dds_common/msg/Gid", data=np.frombuffer(entity.guid.bytes, dtype=np.uint8))
