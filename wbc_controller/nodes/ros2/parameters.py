"""Converts the parameters of a ROS 2 node to a robot's settings, without rclpy."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from wbc_controller.errors import ConfigurationError, valid_choices
from wbc_controller.settings import NODE_NAME, Settings
from wbc_controller.settings.files import (
    find_configuration,
    load_settings,
    parse_settings,
    resolve_paths,
    shipped_configurations,
)
from wbc_controller.settings.nesting import merged, nested

#: Parameters that ROS 2 itself adds to nodes, by the first part of their names.
OF_ROS2 = ("use_sim_time", "start_type_description_service", "qos_overrides")
#: Parameters that name a whole configuration: a shipped robot, or a file.
ROBOT, CONFIG = "robot", "config"
#: Names of the types in errors.
_KINDS = {bool: "true or false", float: "a number"}


def is_of_the_robot(name: str, own: Sequence[str] = ()) -> bool:
    """Return True if a parameter, by its dotted name, belongs to the robot's configuration, not to the node."""
    return name.partition(".")[0] not in OF_ROS2 and name not in (ROBOT, CONFIG, *own)


def flat(settings: BaseModel, prefix: str = "") -> Iterator[tuple[str, Any, str]]:
    """Yield every setting that has a value: its dotted name, its value, and a readable description."""
    live: tuple[str, ...] = getattr(settings, "live", ())
    for name, field in type(settings).model_fields.items():
        value, key = getattr(settings, name), f"{prefix}{name}"
        if isinstance(value, BaseModel):
            yield from flat(value, f"{key}.")
        elif isinstance(value, dict):  # the tasks, or the contacts
            for entry, below in value.items():
                yield from flat(below, f"{key}.{entry}.")
        elif value is not None and value != []:  # a ROS 2 parameter cannot hold these
            when = "May be changed live." if name in live else "Read when the node is configured."
            yield key, value, f"{field.description or 'Kind of task or contact.'} {when}"


def settings_from(
    parameters: Mapping[str, Any], node: str, arguments: Sequence[str], own: Sequence[str] = ()
) -> tuple[Settings, str]:
    """Validate the parameters of a node.

    The parameter ``robot`` or ``config`` names a whole file, whose values other parameters override; without it the
    parameters are the whole configuration, whose relative paths start at the folder of the last parameter file. A node
    without parameters, because no section of the parameter file matches its name, uses the file's section
    ``wbc_controller``, so that the mock robot and a controller in a namespace can be started with the same file.

    Args:
        parameters: values by dotted name.
        node: fully qualified name of the node, for messages.
        own: names of the node's own parameters, which are not the robot's.

    Returns:
        The settings, and their source.

    Raises:
        ConfigurationError: with one line per mistake.
    """
    given = {name: value for name, value in parameters.items() if is_of_the_robot(name, own)}
    path, files = _named_file(parameters, node), parameter_files(arguments)
    if path is None and not given:
        if not files:
            raise ConfigurationError(
                f"{node} has no robot: give -p robot:=<name> ({valid_choices('', shipped_configurations())}), "
                f"-p config:=<file>, or --params-file <file> with the section {NODE_NAME!r}"
            )
        path = files[-1]
    overrides = nested(given)
    if path is None:
        source = f"parameters of {node}"
        return parse_settings(resolve_paths(files[-1], overrides) if files else overrides, source), source
    settings = load_settings(path)
    if not overrides:
        return settings, str(path)
    source = f"{path} with the parameters of {node}"
    return parse_settings(merged(settings.model_dump(exclude_unset=True), overrides), source), source


def own_values(given: Mapping[str, Any], defaults: Mapping[str, Any], node: str) -> dict[str, Any]:
    """Return the values of a node's own parameters, of the types of their defaults; integers become floats.

    Args:
        given: values by name; others than the node's own are ignored.
        defaults: the default of each own parameter.

    Raises:
        ConfigurationError: if a value has another type: the text ``"no"`` is not true.
    """
    chosen = dict(defaults)
    for name, default in defaults.items():
        value = given.get(name, default)
        if type(value) is int and type(default) is float:
            value = float(value)
        if type(value) is not type(default):
            raise ConfigurationError(f"{node}: {name} = {value!r}: must be {_KINDS[type(default)]}")
        chosen[name] = value
    return chosen


def parameter_files(arguments: Sequence[str]) -> list[Path]:
    """Return the parameter files on a command line (``--params-file``), in order."""
    return [Path(path) for flag, path in itertools.pairwise(arguments) if flag == "--params-file"]


def _named_file(parameters: Mapping[str, Any], node: str) -> Path | None:
    named = {key: parameters[key] for key in (ROBOT, CONFIG) if parameters.get(key) not in (None, "")}
    if len(named) == 2:
        raise ConfigurationError(
            f"{node}: robot = {named[ROBOT]!r} and config = {named[CONFIG]!r} both name a configuration; keep one"
        )
    for key, value in named.items():
        if not isinstance(value, str):
            raise ConfigurationError(f"{node}: {key} = {value!r}: must be a text")
        if key == CONFIG and not Path(value).is_file():
            raise ConfigurationError(f"{node}: config = {value!r}: there is no such file")
        return Path(value) if key == CONFIG else find_configuration(value)
    return None
