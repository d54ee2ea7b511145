"""A service as a plain node: parameters in, a run until the process is stopped, an exit status out."""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Callable, Mapping
from typing import Any

from rclpy.node import Node

from wbc_controller.errors import WbcError
from wbc_controller.middleware.transports.ros2 import Ros2Transport
from wbc_controller.nodes.ros2.declaration import declare, values
from wbc_controller.nodes.ros2.parameters import own_values, settings_from
from wbc_controller.nodes.ros2.process import logging_to, spinning

_log = logging.getLogger(__name__)

#: A service: it is called with the settings, a transport, the event that ends it, the node's namespace by keyword, and
#: the node's own parameters by keyword.
Service = Callable[..., None]


def serve_plainly(
    executor: Any,
    stop: threading.Event,
    name: str,
    begins: str,
    service: Service,
    parameters: Mapping[str, tuple[Any, str]] | None = None,
) -> int:
    """Run a service on a node of its own until the event is set, and return the exit status.

    Args:
        executor: spins the node.
        stop: ends the run; set where the executor fails.
        name: of the node.
        begins: sentence for the log at the start, with ``{source}`` for where the settings are from and ``{node}``
            for the full name of the node.
        service: what to run.
        parameters: the node's own parameters, defaults and descriptions by name: the service gets their values.
    """
    node = Node(name, allow_undeclared_parameters=True, automatically_declare_parameters_from_overrides=True)
    given = dict(parameters or {})
    own, full_name = declare(node, given), node.get_fully_qualified_name()
    transport = Ros2Transport(node)
    status: list[int] = []

    def leave(code: int) -> None:
        status.append(code)
        stop.set()

    with logging_to(node), spinning(executor, node, leave):
        try:
            found = values(node)
            chosen = own_values(found, {key: default for key, (default, _) in given.items()}, full_name)
            settings, source = settings_from(found, full_name, sys.argv, own)
            _log.info("%s", begins.format(source=source, node=full_name))
            service(settings, transport, stop, namespace=node.get_namespace(), **chosen)
        except WbcError as error:
            _log.error("%s", error)
            status.append(2)
    transport.close()
    node.destroy_node()
    return status[0] if status else 0
