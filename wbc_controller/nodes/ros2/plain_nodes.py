"""The executables `mock_robot`, `guard` and `base_estimator`."""

import logging
import sys
import threading
from collections.abc import Callable, Mapping
from types import MappingProxyType
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


def serve_mock(executor: Any, stop: threading.Event, leave: Callable[[int], None]) -> None:
    """Run the mock robot until the event is set."""
    from wbc_controller.simulation.mock_service import run_mock

    start_message = "the robot of {source} is held: release it with false on {node}/hold"
    _serve(executor, stop, leave, MOCK_NODE, start_message, run_mock, _MOCK_PARAMETERS)


def serve_guard(executor: Any, stop: threading.Event, leave: Callable[[int], None]) -> None:
    """Run the guard until the event is set."""
    from wbc_controller.nodes.guard_service import run_guard

    _serve(executor, stop, leave, GUARD_NODE, "guarding the robot of {source}", run_guard)


def serve_estimator(executor: Any, stop: threading.Event, leave: Callable[[int], None]) -> None:
    """Run the base estimator until the event is set."""
    from wbc_controller.nodes.estimator_service import run_estimator

    _serve(executor, stop, leave, ESTIMATOR_NODE, "estimating the base of the robot of {source}", run_estimator)


def _serve(
    executor: Any,
    stop: threading.Event,
    leave: Callable[[int], None],
    name: str,
    start_message: str,
    service: Callable[..., None],
    parameters: Mapping[str, tuple[Any, str]] = MappingProxyType({}),
) -> None:
    """Run a service with settings, transport, `stop`, namespace and the values of `parameters`, on its own node.

    The start message may contain the ``{source}`` of the settings and the full name of the ``{node}``.
    """
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
