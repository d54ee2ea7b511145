"""Configuration files: finding them, reading them, and one readable line per mistake in them."""

from __future__ import annotations

import reprlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, get_args, get_origin

import yaml
from pydantic import BaseModel, ValidationError

from wbc_controller.errors import ConfigurationError, valid_choices
from wbc_controller.settings import NODE_NAME, ContactSettings, Settings, TaskSettings
from wbc_controller.settings.resources import PACKAGE_SCHEME, is_file, read_text, share_folder, shown
from wbc_controller.settings.values import LIST, NUMBER

#: Longest configuration file, in characters.
_LARGEST_FILE = 1_000_000
#: Most values of a YAML text, each alias counted as all that it stands for.
_MOST_VALUES = 20_000
#: Longest value of a YAML text, and longest whole number in it, in characters.
_LONGEST_VALUE, _LONGEST_INTEGER = 4096, 32
#: Keys of the settings that are paths.
_PATHS = (("robot", "urdf"), ("limits", "self_collision", "srdf"))
_INTEGER = "tag:yaml.org,2002:int"


def find_configuration(name: str) -> Path:
    """Find a configuration by a shipped robot's name, such as ``g1``, or by path.

    Raises:
        ConfigurationError: if there is no such configuration.
    """
    path = Path(name)
    if path.suffix in (".yaml", ".yml") or len(path.parts) > 1:
        if not is_file(path):
            raise ConfigurationError(
                f"configuration file {shown(name)} does not exist; "
                f"{valid_choices(path.stem, shipped_configurations())}; or the path of a .yaml file"
            )
        return path
    shipped = shipped_configurations()
    if name not in shipped:
        raise ConfigurationError(
            f"no configuration is named {shown(name)}; {valid_choices(name, shipped)}; or give the path of a .yaml file"
        )
    return shipped[name]


def shipped_configurations() -> dict[str, Path]:
    """Map the names of the robots that this package ships to their files."""
    checkout = Path(__file__).resolve().parents[2]
    beside = (checkout / "setup.py").is_file()
    folder = (checkout if beside else share_folder("wbc_controller")) / "config"
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def load_settings(path: Path) -> Settings:
    """Read and validate a ROS 2 parameter file.

    Raises:
        ConfigurationError: with one line per mistake: file, key, value, and the valid choices.
    """
    parameters = read_parameters(read_text(path, str(path), _LARGEST_FILE), str(path))
    return parse_settings(beside(path, parameters), str(path))


def beside(path: Path, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Let the relative paths among ``ros__parameters`` start at the folder of their file; returns a copy."""
    result = dict(parameters)
    for section, *keys in _PATHS:
        if section in result:
            result[section] = _placed(result[section], keys, path.absolute().parent)
    return result


def _placed(value: Any, keys: Sequence[str], folder: Path) -> Any:
    """The value with the path at some keys below it placed in a folder; what is no path stays, to be refused later."""
    if keys:
        if not isinstance(value, Mapping) or keys[0] not in value:
            return value
        return {**value, keys[0]: _placed(value[keys[0]], keys[1:], folder)}
    relative = isinstance(value, str) and value and not value.startswith((PACKAGE_SCHEME, "~", "/"))
    return str(folder / value) if relative else value


def read_yaml(text: str, source: str, loader: Any = yaml.SafeLoader) -> Any:
    """Read a YAML document as plain values: files, and changes that arrive while the controller runs.

    What is too large, with aliases expanded, is refused before any value is made. `source` is its origin, for messages.

    Raises:
        ConfigurationError: if the text is not valid YAML, has a duplicate key, an alias within what it stands for, a
            value or a whole number that is too long, or too many values.
    """
    try:
        reader = loader(text)
        try:
            node = reader.get_single_node()
            if node is None:
                return None
            _count(node, source, (), {})
            return reader.construct_document(node)
        finally:
            reader.dispose()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"{source}:{mark.line + 1}" if mark else source
        raise ConfigurationError(f"{where}: not valid YAML: {error.problem or error.context}") from error
    except ConfigurationError:
        raise
    except Exception as error:  # a value that does not fit its tag can make PyYAML's constructors raise any exception
        kind = f"{type(error).__name__}: " if isinstance(error, (LookupError, AttributeError)) else ""
        raise ConfigurationError(f"{source}: not valid YAML: {kind}{' '.join(str(error).split())}") from error


def yaml_line(value: Any) -> str:
    """A value as YAML on one line, lists and mappings in brackets."""
    text = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, allow_unicode=True, width=10**6)
    return text.removesuffix("\n").removesuffix("\n...")


def parse_settings(parameters: Mapping[str, Any], source: str) -> Settings:
    """Validate a nested dictionary of ``ros__parameters``; `source` is its origin, for messages.

    Raises:
        ConfigurationError: as in `load_settings`.
    """
    try:
        return Settings.model_validate(parameters)
    except ValidationError as error:
        lines = [_explain(problem, source) for problem in error.errors()]
        raise ConfigurationError("\n".join(lines)) from error


def _count(node: yaml.Node, source: str, keys: tuple[str, ...], counts: dict[int, int]) -> int:
    """Count the values of a node with aliases expanded, visiting each node once; refuse what `read_yaml` refuses."""
    where = f"{source}:{node.start_mark.line + 1}"
    if id(node) in counts:
        if not counts[id(node)]:
            raise ConfigurationError(f"{where}: not valid YAML: an alias stands within what it stands for")
        return counts[id(node)]
    counts[id(node)] = 0  # until it is counted
    count = 1
    if isinstance(node, yaml.ScalarNode):
        longest = _LONGEST_INTEGER if node.tag == _INTEGER else _LONGEST_VALUE
        if len(node.value) > longest:
            what = "whole number" if node.tag == _INTEGER else "value"
            raise ConfigurationError(
                f"{where}: {_dotted(keys)}: a {what} of {len(node.value)} characters; it has at most {longest}"
            )
    elif isinstance(node, yaml.SequenceNode):
        for value in node.value:
            count += _count(value, source, keys, counts)
    elif isinstance(node, yaml.MappingNode):
        lines: dict[str, int] = {}
        for key_node, value in node.value:
            count += _count(key_node, source, keys, counts)
            key, line = str(key_node.value), key_node.start_mark.line + 1
            if key in lines:  # YAML itself would silently use the last one
                raise ConfigurationError(
                    f"{source}:{line}: {_dotted((*keys, key))}: the key {key!r} stands twice, first in line "
                    f"{lines[key]}; keep one of them"
                )
            lines[key] = line
            count += _count(value, source, (*keys, key), counts)
    if count > _MOST_VALUES:
        raise ConfigurationError(
            f"{where}: {_dotted(keys)}: more than {_MOST_VALUES} values, each alias counted as what it stands for"
        )
    counts[id(node)] = count
    return count


def _dotted(keys: tuple[str, ...]) -> str:
    """A key as in all messages: without the node and ros__parameters."""
    return ".".join(keys[2:] if keys[1:2] == ("ros__parameters",) else keys) or "the text"


def read_parameters(text: str, source: str) -> Mapping[str, Any]:
    """Read the ``ros__parameters`` of a ROS 2 parameter file; `source` is its origin, for messages.

    Raises:
        ConfigurationError: if the text is not valid YAML, or not a parameter file.
    """
    content = read_yaml(text, source)
    form = f"a ROS 2 parameter file starts with\n  {NODE_NAME}:\n    ros__parameters:"
    if not isinstance(content, dict):
        raise ConfigurationError(f"{source}: holds {type(content).__name__}, not a mapping; {form}")
    node = content.get(NODE_NAME, content.get("/**"))
    if not isinstance(node, dict):
        raise ConfigurationError(f"{source}: has no key {NODE_NAME!r} (found: {', '.join(map(repr, content))}); {form}")
    parameters = node.get("ros__parameters")
    if not isinstance(parameters, dict):
        raise ConfigurationError(f"{source}: {NODE_NAME} has no mapping 'ros__parameters'; {form}")
    return parameters


def _explain(problem: Any, source: str) -> str:
    """Turn one of pydantic's errors into a line: file, key, value, valid choices."""
    location = [part for part in problem["loc"] if part not in (NUMBER, LIST)]
    if len(location) > 2 and location[2] in _tags_of(str(location[0])):
        del location[2]  # the kind of the task or contact, which is not a key of the file
    if location[-1:] == ["[key]"]:
        return f"{source}: {'.'.join(map(str, location[:-2]))}: {problem['msg'].removeprefix('Value error, ')}"
    key = ".".join(text if (text := str(part)).isprintable() else repr(text) for part in location)
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
