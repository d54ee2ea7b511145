"""Groups of transports that can hear each other, and nobody else, on each middleware."""

import threading
from importlib.util import find_spec
from types import SimpleNamespace
from typing import Any

import pytest
from domains import own_domain

from wbc_controller.middleware.topics import TASK_TYPES, Endpoint
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.middleware.transports.transport import Transport

DOMAIN = own_domain()
#: Stand-in of settings with a task of every type.
EVERY_TASK: Any = SimpleNamespace(
    tasks={kind: SimpleNamespace(type=kind) for kind in TASK_TYPES}, contacts=("left", "right")
)


def is_omitted(endpoint: Endpoint) -> bool:
    """Whether nodes on rclpy omit a topic here: the wheels of PyPI have no tf2_msgs."""
    return endpoint.type.startswith("tf2_msgs/") and find_spec("rclpy") is not None and find_spec("tf2_msgs") is None


class MemoryParticipants:
    def __init__(self) -> None:
        self._bus = MemoryBus()

    def transport(self, node: str, namespace: str = "/") -> Transport:
        return MemoryTransport(self._bus, node, namespace)

    def close(self) -> None:
        pass


class DdsParticipants:
    def transport(self, node: str, namespace: str = "/") -> Transport:
        from wbc_controller.middleware.transports.dds import DdsTransport

        return DdsTransport(node, namespace, DOMAIN, "LOCALHOST")

    def close(self) -> None:
        pass


class Ros2Participants:
    def __init__(self, domain: int = DOMAIN) -> None:
        try:
            import rclpy
            from rclpy.executors import SingleThreadedExecutor
        except ImportError as error:
            pytest.skip(f"rclpy is not importable: {error}")
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.executor = SingleThreadedExecutor(context=self.context)
        self._nodes: list[Any] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()

    def node(self, name: str, namespace: str = "/") -> Any:
        import rclpy

        self._nodes.append(rclpy.create_node(name, namespace=namespace, context=self.context))
        self.executor.add_node(self._nodes[-1])
        return self._nodes[-1]

    def transport(self, node: str, namespace: str = "/") -> Transport:
        from wbc_controller.middleware.transports.ros2 import Ros2Transport

        return Ros2Transport(self.node(node, namespace))

    def stop(self) -> None:
        """End the executor."""
        if self._ended.is_set():
            return
        self._ended.set()
        self.executor.create_task(lambda: None)
        self._thread.join()
        self.executor.shutdown()

    def close(self) -> None:
        self.stop()
        for node in self._nodes:
            node.destroy_node()
        self.context.shutdown()

    def _spin(self) -> None:
        while not self._ended.is_set():
            self.executor.spin_once()
