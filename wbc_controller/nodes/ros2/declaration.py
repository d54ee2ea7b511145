"""The parameters of the nodes themselves, beside those of the robot."""

from __future__ import annotations

from typing import Any

from rcl_interfaces.msg import ParameterDescriptor

from wbc_controller.nodes.ros2.parameters import CONFIG, ROBOT

_FILE_PARAMETERS: dict[str, tuple[Any, str]] = {
    ROBOT: ("", "Name of a robot that is shipped; other parameters are put over its configuration."),
    CONFIG: ("", "Path of a robot's configuration; other parameters are put over it."),
}


def declare(node: Any, parameters: dict[str, tuple[Any, str]]) -> tuple[str, ...]:
    """Declare a node's own parameters, unless the command line has already done so."""
    for name, (default, description) in (parameters | _FILE_PARAMETERS).items():
        descriptor = ParameterDescriptor(description=description, dynamic_typing=True)
        if node.has_parameter(name):
            node.set_descriptor(name, descriptor)
        elif name != ROBOT:  # with robot.urdf and the like, `ros2 param dump` would fail on it
            node.declare_parameter(name, default, descriptor)
    return tuple(parameters)


def values(node: Any) -> dict[str, Any]:
    """The values of a node's parameters by name, without parameters that are not set."""
    parameters = node.get_parameters_by_prefix("").items()
    return {name: parameter.value for name, parameter in parameters if parameter.value is not None}
