"""The parameters of a node: its own, and the settings of its controller, which may be changed live."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.parameter import Parameter

from wbc_controller.controller.live_settings import LiveSettings
from wbc_controller.errors import ConfigurationError
from wbc_controller.nodes.ros2.parameters import CONFIG, ROBOT, flat, is_of_the_robot
from wbc_controller.settings.nesting import nested

_log = logging.getLogger(__name__)


_FILE_PARAMETERS: Mapping[str, tuple[Any, str]] = {
    ROBOT: ("", "Name of a robot that is shipped; other parameters are put over its configuration."),
    CONFIG: ("", "Path of a robot's configuration; other parameters are put over it."),
}


def declare(node: Any, parameters: Mapping[str, tuple[Any, str]]) -> tuple[str, ...]:
    """Declare a node's own parameters, except those that the command line has declared; returns their names."""
    for name, (default, description) in {**parameters, **_FILE_PARAMETERS}.items():
        descriptor = ParameterDescriptor(description=description, dynamic_typing=True)
        if node.has_parameter(name):
            node.set_descriptor(name, descriptor)
        elif name != ROBOT:  # with robot.urdf and the like, `ros2 param dump` would fail on it
            node.declare_parameter(name, default, descriptor)
    return tuple(parameters)


def values(node: Any) -> dict[str, Any]:
    """Return the values of a node's parameters by name, without parameters that are not set."""
    parameters = node.get_parameters_by_prefix("").items()
    return {name: parameter.value for name, parameter in parameters if parameter.value is not None}


class LiveParameters:
    """Keeps the parameters of a node and the settings of its controller in agreement.

    While there is a controller, a new value is first checked against the schema, and refused with the reason if it is
    invalid; the controller's loop then adopts it between two cycles. Without a controller any value may be set: it is
    checked against the schema when the node is configured.

    Args:
        own: names of the node's own parameters.
    """

    def __init__(self, node: Any, own: Sequence[str]) -> None:
        self._node = node
        self._own = own
        self._live: LiveSettings | None = None
        self._shown: dict[str, Any] = {}
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._accept)

    def show(self, live: LiveSettings) -> None:
        """Declare the settings as parameters, which from then on change live."""
        settings = {
            key: (value, ParameterDescriptor(description=description, dynamic_typing=True))
            for key, value, description in self._showable(live)
        }
        for key, (_, descriptor) in settings.items():
            if self._node.has_parameter(key):
                self._node.set_descriptor(key, descriptor)
        new = {key: pair for key, pair in settings.items() if not self._node.has_parameter(key)}
        self._node.declare_parameters("", [(key, *pair) for key, pair in new.items()])
        self._shown = {key: value for key, (value, _) in new.items()}
        self._live = live
        live.changed = self._on_change

    def hide(self) -> None:
        """Drop the controller, and undeclare the parameters of `show`, except those that were set since."""
        self._live = None
        for key, value in self._shown.items():
            if self._node.has_parameter(key) and _plain(self._node.get_parameter(key).value) == value:
                self._node.undeclare_parameter(key)
        self._shown = {}

    def _showable(self, live: LiveSettings) -> list[tuple[str, Any, str]]:
        """The settings, except sections whose name is also a parameter: `ros2 param dump` cannot write both."""
        named = self._node.has_parameter(ROBOT)
        return [each for each in flat(live.settings) if not (named and each[0].startswith(f"{ROBOT}."))]

    def _change(self, parameters: Sequence[Any]) -> dict[str, Any]:
        return {each.name: each.value for each in parameters if is_of_the_robot(each.name, self._own)}

    def _check(self, parameters: Sequence[Any]) -> Any:
        if self._live is None:
            return SetParametersResult(successful=True)
        fixed = [each.name for each in parameters if each.name in (ROBOT, CONFIG, "use_sim_time")]
        try:
            if fixed:
                raise ConfigurationError(f"{', '.join(fixed)}: read only when the node is configured")
            change = self._change(parameters)
            if change:
                self._live.check(nested(change), "parameters")
        except ConfigurationError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _accept(self, parameters: Sequence[Any]) -> None:
        change = self._change(parameters)
        if self._live is None or not change:
            return
        try:
            self._live.accept(nested(change), "parameters")
        except ConfigurationError as error:  # a change on ~/update has arrived since the check
            _log.error("%s", error)

    def _on_change(self) -> None:
        """Show changes by ``~/update`` as parameters; may be called on any thread."""
        executor = self._node.executor
        if executor is not None:
            executor.create_task(self._follow)

    def _follow(self) -> None:
        if self._live is None:
            return
        node = self._node
        changed = [
            Parameter(key, value=value)
            for key, value, _ in self._showable(self._live)
            if not node.has_parameter(key) or _plain(node.get_parameter(key).value) != value
        ]
        if changed:
            node.set_parameters_atomically(changed)


def _plain(value: Any) -> Any:
    """Convert a parameter's value to the form of the settings: arrays become lists."""
    return list(value) if isinstance(value, Sequence) and not isinstance(value, (str, bytes)) else value
