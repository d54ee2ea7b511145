"""Configuration files: finding them, reading them, and one readable line per mistake in them."""

from __future__ import annotations

import reprlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args, get_origin

import yaml
from pydantic import BaseModel, ValidationError

from wbc_controller.errors import ConfigurationError, valid_choices
from wbc_controller.settings import LIST, NODE_NAME, NUMBER, ContactSettings, Settings, TaskSettings
from wbc_controller.settings.resources import share_folder


def find_configuration(name: str) -> Path:
    """Find a configuration by a shipped robot's name, such as ``g1``, or by path.

    Raises:
        ConfigurationError: if there is no such configuration.
    """
    path = Path(name)
    if path.suffix in (".yaml", ".yml") or len(path.parts) > 1:
        if not path.is_file():
            raise ConfigurationError(
                f"configuration file {name!r} does not exist; {valid_choices(path.stem, shipped_configurations())}; "
                "or the path of a .yaml file"
            )
        return path
    shipped = shipped_configurations()
    if name not in shipped:
        raise ConfigurationError(
            f"no configuration is named {name!r}; {valid_choices(name, shipped)}; or give the path of a .yaml file"
        )
    return shipped[name]


def shipped_configurations() -> dict[str, Path]:
    """Map the names of the robots that this package ships to their files."""
    checkout = Path(__file__).resolve().parents[2]
    beside = (checkout / "setup.py").is_file()
    folder = (checkout if beside else share_folder("wbc_controller")) / "config"
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def load_settings(path: Path) -> Settings:
    """Read and validate a configuration file.

    Args:
        path: a ROS 2 parameter file.

    Raises:
        ConfigurationError: with one line per mistake: file, key, value, and the valid choices.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{path}: cannot be read: {error}") from error
    try:
        _refuse_duplicates(yaml.compose(text, Loader=yaml.SafeLoader), path)
        content = yaml.safe_load(text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"{path}:{mark.line + 1}" if mark else str(path)
        raise ConfigurationError(f"{where}: not valid YAML: {error.problem or error.context}") from error
    except (yaml.YAMLError, ValueError, TypeError, RecursionError) as error:
        # The last three are raised on impossible dates and numbers, on keys that are lists, and on deep nesting.
        raise ConfigurationError(f"{path}: not valid YAML: {' '.join(str(error).split())}") from error
    return parse_settings(_parameters_of(content, path), str(path))


def parse_settings(parameters: Mapping[str, Any], source: str) -> Settings:
    """Validate a nested dictionary of parameters.

    Args:
        parameters: the content of ``ros__parameters``.
        source: its origin, for messages.

    Raises:
        ConfigurationError: as in `load_settings`.
    """
    try:
        return Settings.model_validate(parameters)
    except ValidationError as error:
        lines = [_explain(problem, source) for problem in error.errors()]
        raise ConfigurationError("\n".join(lines)) from error


def _refuse_duplicates(node: yaml.Node | None, path: Path, keys: tuple[str, ...] = ()) -> None:
    """Refuse a duplicate key, since YAML itself would silently use the last one."""
    if not isinstance(node, yaml.MappingNode):
        return
    lines: dict[str, int] = {}
    for key_node, value_node in node.value:
        line = key_node.start_mark.line + 1
        key = str(key_node.value)
        if key in lines:
            dotted = ".".join([*keys[2:], key])  # without the node and ros__parameters, as in all messages
            raise ConfigurationError(
                f"{path}:{line}: {dotted}: the key {key!r} stands twice, first in line {lines[key]}; keep one of them"
            )
        lines[key] = line
        _refuse_duplicates(value_node, path, (*keys, key))


def _parameters_of(content: Any, path: Path) -> Mapping[str, Any]:
    form = f"a ROS 2 parameter file starts with\n  {NODE_NAME}:\n    ros__parameters:"
    if not isinstance(content, dict):
        raise ConfigurationError(f"{path}: holds {type(content).__name__}, not a mapping; {form}")
    node = content.get(NODE_NAME, content.get("/**"))
    if not isinstance(node, dict):
        raise ConfigurationError(f"{path}: has no key {NODE_NAME!r} (found: {', '.join(map(repr, content))}); {form}")
    parameters = node.get("ros__parameters")
    if not isinstance(parameters, dict):
        raise ConfigurationError(f"{path}: {NODE_NAME} has no mapping 'ros__parameters'; {form}")
    return parameters


def _explain(problem: Any, source: str) -> str:
    """Turn one of pydantic's errors into a line: file, key, value, valid choices."""
    location = [part for part in problem["loc"] if part not in (NUMBER, LIST)]
    if len(location) > 2 and location[2] in _tags_of(str(location[0])):
        del location[2]  # the kind of the task or contact, which is not a key of the file
    key = ".".join(str(part) for part in location)
    about = _description(problem["loc"])
    about = f" ({about})" if about else ""
    if problem["type"] == "extra_forbidden":
        choices = _fields_at(problem["loc"])
        return f"{source}: {key}: unknown key; {valid_choices(str(location[-1]), choices)}"
    if problem["type"] == "missing":
        return f"{source}: {key}: this key is missing{about}"
    if problem["type"] in ("union_tag_invalid", "union_tag_not_found"):
        kind = problem["input"].get("type") if isinstance(problem["input"], dict) else problem["input"]
        tags = _tags_of(str(location[0]))
        if kind is None:
            return f"{source}: {key}.type: this key is missing; {valid_choices('', tags)}"
        return f"{source}: {key}.type: unknown type {kind!r}; {valid_choices(str(kind), tags)}"
    reason = problem["msg"].removeprefix("Value error, ")
    value = problem["input"]
    if problem["type"] == "value_error" and isinstance(value, dict):  # from a validator of several keys
        return f"{source}: {key}{'.' if key else ''}{reason}"
    shown = "" if isinstance(value, dict) else f" = {reprlib.repr(value)}"
    return f"{source}: {key}{shown}: {reason[0].lower()}{reason[1:]}{about}"


def _members(section: str) -> dict[str, type[BaseModel]]:
    union = {"tasks": TaskSettings, "contacts": ContactSettings}.get(section)
    if union is None:
        return {}
    return {str(get_args(kind.model_fields["type"].annotation)[0]): kind for kind in get_args(get_args(union)[0])}


def _tags_of(section: str) -> set[str]:
    return set(_members(section))


def _fields_at(location: tuple[Any, ...]) -> Mapping[str, Any]:
    """The valid keys at the level of a location's last part."""
    if len(location) == 1:
        return Settings.model_fields
    section = str(location[0])
    members = _members(section)
    if members:
        member = members.get(str(location[2])) if len(location) > 3 else None
        return member.model_fields if member is not None else {}
    model: Any = Settings
    for part in location[:-1]:
        if get_origin(model) is dict:
            model = get_args(model)[1]
        elif str(part) in getattr(model, "model_fields", {}):
            model = model.model_fields[str(part)].annotation
        else:
            return {}
    return model.model_fields if isinstance(model, type) and issubclass(model, BaseModel) else {}


def _description(location: tuple[Any, ...]) -> str:
    """Description of a key, for messages; an item of a list has the description of the list's key."""
    keys = tuple(part for part in location if part not in (NUMBER, LIST))
    if keys and isinstance(keys[-1], int):
        keys = keys[:-1]
    field = _fields_at(keys).get(str(keys[-1])) if keys else None
    return str(field.description).rstrip(".") if field is not None and field.description else ""
