"""The estimator of the base as a plain node: the executable `base_estimator`."""

from __future__ import annotations

import logging
import sys
import threading
from typing import Any

from rclpy.node import Node

from wbc_controller.errors import WbcError
from wbc_controller.ros2.declaration import declare, values
from wbc_controller.ros2.parameters import settings_from
from wbc_controller.ros2.process import logging_to, spinning
from wbc_controller.service.estimator_service import run_estimator
from wbc_controller.transports.ros2 import Ros2Transport
from wbc_controller.wire.topics import ESTIMATOR_NODE

_log = logging.getLogger(__name__)


def serve(executor: Any, stop: threading.Event) -> int:
    """Run the node until the event is set, and return the exit status."""
    node = Node(ESTIMATOR_NODE, allow_undeclared_parameters=True, automatically_declare_parameters_from_overrides=True)
    own = declare(node, {})
    transport = Ros2Transport(node)
    status: list[int] = []

    def leave(code: int) -> None:
        status.append(code)
        stop.set()

    with logging_to(node), spinning(executor, node, leave):
        try:
            settings, source = settings_from(values(node), node.get_fully_qualified_name(), sys.argv, own)
            _log.info("estimating the base of the robot of %s", source)
            run_estimator(settings, transport, stop, namespace=node.get_namespace())
        except WbcError as error:
            _log.error("%s", error)
            status.append(2)
    transport.close()
    node.destroy_node()
    return status[0] if status else 0
