"""The executables `mock_robot`, `guard` and `base_estimator`."""

import importlib
import logging
import sys
import threading
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from rclpy.node import Node

from wbc_controller.errors import WbcError
from wbc_controller.middleware.topics import ESTIMATOR_NODE, GUARD_NODE, MOCK_NODE
from wbc_controller.middleware.transports.ros2 import Ros2Transport
from wbc_controller.nodes.ros2.node_parameters import FROM_OVERRIDES, declare, values
from wbc_controller.nodes.ros2.parameters import own_values, settings_from
from wbc_controller.nodes.ros2.process import logging_to, spinning

_log = logging.getLogger(__name__)

#: Own parameters of the mock robot's node: default and description.
_MOCK_PARAMETERS: Mapping[str, tuple[Any, str]] = {
    "real_time_factor": (1.0, "Simulated seconds per second."),
    "lockstep": (False, "Wait for the controller's command after each state."),
    "patient": (False, "Let simulated time wait for a late controller with use_sim_time."),
}
#: By node: module of the service, imported on use as the guard runs without Pinocchio; function; message at the start,
#: with the ``{source}`` of the settings and the full name of the ``{node}``; own parameters.
_SERVICES: Mapping[str, tuple[str, str, str, Mapping[str, tuple[Any, str]]]] = {
    MOCK_NODE: (
        "simulation.mock_service", "run_mock",
        "the robot of {source} is held: release it with false on {node}/hold", _MOCK_PARAMETERS,
    ),
    GUARD_NODE: ("nodes.guard_service", "run_guard", "guarding the robot of {source}", {}),
    ESTIMATOR_NODE: ("nodes.estimator_service", "run_estimator", "estimating the base of the robot of {source}", {}),
}  # fmt: skip


def _serve(name: str, executor: Any, stop: threading.Event, leave: Callable[[int], None]) -> None:
    """Run a service on its own node until the event is set."""
    module, function, start_message, parameters = _SERVICES[name]
    service = getattr(importlib.import_module(f"wbc_controller.{module}"), function)
    node = Node(name, **FROM_OVERRIDES)
    own, full_name = declare(node, parameters), node.get_fully_qualified_name()
    transport = Ros2Transport(node)
    with logging_to(node), spinning(executor, node, leave):
        try:
            found = values(node)
            chosen = own_values(found, {key: default for key, (default, _) in parameters.items()}, full_name)
            settings, source = settings_from(found, full_name, sys.argv, own)
            _log.info("%s", start_message.format(source=source, node=full_name))
            service(settings, transport, stop, namespace=node.get_namespace(), **chosen)
        except WbcError as error:
            _log.error("%s", error)
            leave(2)
    transport.close()
    node.destroy_node()


serve_mock = partial(_serve, MOCK_NODE)
serve_guard = partial(_serve, GUARD_NODE)
serve_estimator = partial(_serve, ESTIMATOR_NODE)
