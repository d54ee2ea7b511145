"""Announces which node owns which readers and writers, for `ros2 node list` and `ros2 topic info -v`."""

from __future__ import annotations

from typing import Any

import numpy as np
from cyclonedds.core import Policy, Qos
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic

from wbc_controller.transports import dds_raw
from wbc_controller.transports.dds_types import idl_type, type_hash
from wbc_controller.wire.messages import encode, message

_TYPE = "rmw_dds_common/msg/ParticipantEntitiesInfo"


class NodeAnnouncement:
    """Announces to ROS 2 the name of the node that owns a participant's readers and writers.

    DDS itself has no nodes: ROS 2 adds them by this topic, a list that is published again at each change.
    """

    def __init__(self, participant: Any, node: str, namespace: str) -> None:
        self._participant_gid = _gid(participant)
        self._node, self._namespace = node, namespace
        self._readers: list[Any] = []
        self._writers: list[Any] = []
        qos = Qos(
            Policy.Reliability.Reliable(max_blocking_time=0),
            Policy.Durability.TransientLocal,
            Policy.History.KeepLast(1),
            Policy.WriterDataLifecycle(autodispose=False),
            Policy.DataRepresentation(use_cdrv0_representation=True),
            Policy.Userdata(f"typehash={type_hash(_TYPE)};".encode()),
        )
        self._topic = Topic(participant, "ros_discovery_info", idl_type(_TYPE))
        self._writer = DataWriter(participant, self._topic, qos)
        self._publish()

    def add_reader(self, reader: Any) -> None:
        """Announce a reader."""
        self._readers.append(_gid(reader))
        self._publish()

    def add_writer(self, writer: Any) -> None:
        """Announce a writer."""
        self._writers.append(_gid(writer))
        self._publish()

    def delete(self) -> None:
        """Delete the announcement's own entities."""
        dds_raw.delete(self._writer)
        dds_raw.delete(self._topic)

    def _publish(self) -> None:
        node = message(
            "rmw_dds_common/msg/NodeEntitiesInfo",
            node_namespace=self._namespace,
            node_name=self._node,
            reader_gid_seq=self._readers,
            writer_gid_seq=self._writers,
        )
        announcement = message(_TYPE, gid=self._participant_gid, node_entities_info_seq=[node])
        dds_raw.write(self._writer, encode(announcement))


def _gid(entity: Any) -> Any:
    """Return ROS 2's identifier of a DDS entity: on Jazzy, the sixteen bytes of its GUID."""
    return message("rmw_dds_common/msg/Gid", data=np.frombuffer(entity.guid.bytes, dtype=np.uint8))
