"""Parameters of a node."""

import logging
from collections.abc import Mapping, Sequence
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.parameter import Parameter

from wbc_controller.controller.live_settings import LiveSettings
from wbc_controller.errors import ConfigurationError
from wbc_controller.nodes.ros2.parameters import CONFIG, ROBOT, flatten, is_robot_parameter
from wbc_controller.settings.nesting import nested

_log = logging.getLogger(__name__)

#: Options of a node that has the parameters of its files and command line.
FROM_OVERRIDES = {"allow_undeclared_parameters": True, "automatically_declare_parameters_from_overrides": True}
_FILE_PARAMETERS: Mapping[str, tuple[Any, str]] = {
    ROBOT: ("", "Name of a shipped robot; other parameters override its configuration."),
    CONFIG: ("", "Path of a robot's configuration; other parameters override it."),
}


def declare(node: Any, parameters: Mapping[str, tuple[Any, str]]) -> tuple[str, ...]:
    """Declare a node's own parameters, unless declared by the command line, and return their names."""
    for name, (default, description) in {**parameters, **_FILE_PARAMETERS}.items():
        descriptor = ParameterDescriptor(description=description, dynamic_typing=True)
        if node.has_parameter(name):
            node.set_descriptor(name, descriptor)
        elif name != ROBOT:  # `ros2 param dump` cannot write robot together with robot.urdf
            node.declare_parameter(name, default, descriptor)
    return tuple(parameters)


def values(node: Any) -> dict[str, Any]:
    """Return the set parameters of a node by name."""
    return {name: each.value for name, each in node.get_parameters_by_prefix("").items() if each.value is not None}


class LiveParameters:
    """Synchronization of a node's parameters with the settings of its controller.

    The loop of a controller adopts a valid value between two cycles. Without a controller, configuring the node checks
    the values.
    """

    def __init__(self, node: Any, own: Sequence[str]) -> None:
        self._node = node
        self._own = own
        self._live: LiveSettings | None = None
        self._declared: dict[str, Any] = {}
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._accept)

    def declare_settings(self, live: LiveSettings) -> None:
        """Declare the settings as parameters with live changes."""
        new = []
        for key, value, description in self._declarable(live):
            descriptor = ParameterDescriptor(description=description, dynamic_typing=True)
            if self._node.has_parameter(key):
                self._node.set_descriptor(key, descriptor)
            else:
                new.append((key, value, descriptor))
        self._node.declare_parameters("", new)
        self._declared = {key: value for key, value, _ in new}
        self._live = live
        live.changed = self._on_change

    def undeclare_settings(self) -> None:
        """Detach the controller, and undeclare the unchanged parameters of `declare_settings`."""
        self._live = None
        for key, value in self._declared.items():
            if self._node.has_parameter(key) and _plain(self._node.get_parameter(key).value) == value:
                self._node.undeclare_parameter(key)
        self._declared = {}

    def _declarable(self, live: LiveSettings) -> list[tuple[str, Any, str]]:
        named = self._node.has_parameter(ROBOT)
        return [each for each in flatten(live.settings) if not (named and each[0].startswith(f"{ROBOT}."))]

    def _change(self, parameters: Sequence[Any]) -> dict[str, Any]:
        return {each.name: each.value for each in parameters if is_robot_parameter(each.name, self._own)}

    def _check(self, parameters: Sequence[Any]) -> Any:
        if self._live is None:
            return SetParametersResult(successful=True)
        fixed = [each.name for each in parameters if each.name in (ROBOT, CONFIG, "use_sim_time")]
        try:
            if fixed:
                raise ConfigurationError(f"{', '.join(fixed)}: not live; configure the node again to change it")
            change = self._change(parameters)
            if change:
                self._live.validated(nested(change), "parameters")
        except ConfigurationError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _accept(self, parameters: Sequence[Any]) -> None:
        change = self._change(parameters)
        if self._live is None or not change:
            return
        try:
            self._live.accept(nested(change), "parameters")
        except ConfigurationError as error:  # after another change on ~/update since the check
            _log.error("%s", error)

    def _on_change(self) -> None:
        if self._node.executor is not None:
            self._node.executor.create_task(self._update_parameters)

    def _update_parameters(self) -> None:
        if self._live is None:
            return
        node = self._node
        changed = [
            Parameter(key, value=value)
            for key, value, _ in self._declarable(self._live)
            if not node.has_parameter(key) or _plain(node.get_parameter(key).value) != value
        ]
        if changed:
            node.set_parameters_atomically(changed)


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, Sequence) and not isinstance(value, (str, bytes)) else value
