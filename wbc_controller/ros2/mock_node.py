"""The mock robot as a plain node: the executable `mock_robot`."""

from __future__ import annotations

import logging
import sys
import threading
from typing import Any

from rclpy.node import Node

from wbc_controller.errors import WbcError
from wbc_controller.mock.service import run_mock
from wbc_controller.ros2.declaration import declare, values
from wbc_controller.ros2.parameters import settings_from
from wbc_controller.ros2.process import logging_to, spinning
from wbc_controller.transports.ros2 import Ros2Transport

_log = logging.getLogger(__name__)

NODE_NAME = "mock_robot"
_PARAMETERS: dict[str, tuple[Any, str]] = {
    "real_time_factor": (1.0, "Simulated seconds per second."),
    "lockstep": (False, "Wait for the controller's answer to each state."),
}


def serve(executor: Any, stop: threading.Event) -> int:
    """Run the node until the event is set, and return the exit status."""
    node = Node(NODE_NAME, allow_undeclared_parameters=True, automatically_declare_parameters_from_overrides=True)
    own = declare(node, _PARAMETERS)
    transport = Ros2Transport(node)
    status: list[int] = []

    def leave(code: int) -> None:
        status.append(code)
        stop.set()

    with logging_to(node), spinning(executor, node, leave):
        try:
            name = node.get_fully_qualified_name()
            settings, source = settings_from(values(node), name, sys.argv, own)
            _log.info("the robot of %s, held: let it go with false on %s/hold", source, name)
            run_mock(
                settings,
                transport,
                stop,
                namespace=node.get_namespace(),
                real_time_factor=float(node.get_parameter("real_time_factor").value),
                lockstep=bool(node.get_parameter("lockstep").value),
            )
        except WbcError as error:
            _log.error("%s", error)
            status.append(2)
    transport.close()
    node.destroy_node()
    return status[0] if status else 0
