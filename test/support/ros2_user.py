"""A node on rclpy that commands and listens, with the types of messages by name."""

import importlib
from functools import partial
from typing import Any

from launching import PATIENCE
from waiting import until

STRING = "std_msgs/msg/String"


class Ros2User:
    until = staticmethod(partial(until, patience=2.0 * PATIENCE))

    def __init__(self, node: Any) -> None:
        self.node = node

    def publisher(self, topic: str, kind: str = STRING) -> Any:
        return self.node.create_publisher(_message_class(kind), topic, 10)

    def hear(self, topic: str, kind: str = STRING, *, latched: bool = False) -> list[Any]:
        """Return the messages of a topic in a list that grows; of std_msgs their data."""
        from rclpy.qos import DurabilityPolicy, QoSProfile

        heard: list[Any] = []
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        qos = QoSProfile(depth=10, durability=durability)
        self.node.create_subscription(
            _message_class(kind), topic, lambda message: heard.append(getattr(message, "data", message)), qos
        )
        return heard


def _message_class(kind: str) -> Any:
    package, _, name = kind.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)
