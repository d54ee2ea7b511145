"""Conversion of ROS 2 parameters, without rclpy."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from wbc_controller.errors import ConfigurationError, valid_choices
from wbc_controller.settings import NODE_NAME, Settings, files
from wbc_controller.settings.nesting import merged, nested

#: Parameters of ROS 2 itself, by the first part of their names.
OF_ROS2 = ("use_sim_time", "start_type_description_service", "qos_overrides")
ROBOT, CONFIG = "robot", "config"  # naming a configuration: a shipped robot, or a file
_KINDS = {bool: "true or false", float: "a number"}  # names of the types in errors


def is_robot_parameter(name: str, own: Sequence[str] = ()) -> bool:
    """Return True if a dotted parameter name belongs to the robot's configuration, not to the node."""
    return name.partition(".")[0] not in OF_ROS2 and name not in (ROBOT, CONFIG, *own)


def flatten(settings: BaseModel, prefix: str = "") -> Iterator[tuple[str, Any, str]]:
    """Yield dotted name, value and description of each setting with a value."""
    live: tuple[str, ...] = getattr(settings, "live", ())
    for name, field in type(settings).model_fields.items():
        value, key = getattr(settings, name), f"{prefix}{name}"
        if isinstance(value, BaseModel):
            yield from flatten(value, f"{key}.")
        elif isinstance(value, dict):  # the tasks, or the contacts
            for entry, below in value.items():
                yield from flatten(below, f"{key}.{entry}.")
        elif value is not None and value != []:  # not representable as ROS 2 parameters
            when = "May be changed live." if name in live else "Read when the node is configured."
            yield key, value, f"{field.description or 'Kind of task or contact.'} {when}"


def settings_from(
    parameters: Mapping[str, Any], node: str, arguments: Sequence[str], own: Sequence[str] = ()
) -> tuple[Settings, str]:
    """Return the validated settings of a node's parameters, and their source.

    - With ``robot`` or ``config``, the other parameters override the named configuration.
    - Without them, the parameters are the whole configuration; relative paths start at the last parameter file.
    - Without any parameter (no section of the file matches the node), the file's section ``wbc_controller`` is used.

    A `ConfigurationError` has one line per error.
    """
    given = {name: value for name, value in parameters.items() if is_robot_parameter(name, own)}
    path = _named_file(parameters, node)
    passed = [Path(text) for flag, text in itertools.pairwise(arguments) if flag == "--params-file"]
    if path is None and not given:
        if not passed:
            raise ConfigurationError(
                f"{node} has no robot: pass -p robot:=<name> ({valid_choices('', files.shipped_configurations())}), "
                f"-p config:=<file>, or --params-file <file> with the section {NODE_NAME!r}"
            )
        path = passed[-1]
    overrides = nested(given)
    if path is None:
        source = f"parameters of {node}"
        given = files.resolve_paths(passed[-1], overrides) if passed else overrides
        return files.parse_settings(given, source), source
    settings = files.load_settings(path)
    if not overrides:
        return settings, str(path)
    source = f"{path} with the parameters of {node}"
    return files.parse_settings(merged(settings.model_dump(exclude_unset=True), overrides), source), source


def own_values(given: Mapping[str, Any], defaults: Mapping[str, Any], node: str) -> dict[str, Any]:
    """Return the values of a node's own parameters, with the types of their defaults (integers become floats).

    Another type raises `ConfigurationError`.
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


def _named_file(parameters: Mapping[str, Any], node: str) -> Path | None:
    named = {key: parameters[key] for key in (ROBOT, CONFIG) if parameters.get(key) not in (None, "")}
    if len(named) == 2:
        raise ConfigurationError(
            f"{node}: robot = {named[ROBOT]!r} and config = {named[CONFIG]!r} both name a configuration; keep one"
        )
    for key, value in named.items():
        if not isinstance(value, str):
            raise ConfigurationError(f"{node}: {key} = {value!r}: must be a string")
        if key == CONFIG and not Path(value).is_file():
            raise ConfigurationError(f"{node}: config = {value!r}: file not found")
        return Path(value) if key == CONFIG else files.find_configuration(value)
    return None
