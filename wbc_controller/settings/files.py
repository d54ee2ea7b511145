"""Configuration files: reading and validation."""

import os
import reprlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

import yaml
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from wbc_controller.errors import ConfigurationError, valid_choices
from wbc_controller.settings import NODE_NAME, Settings
from wbc_controller.settings.nesting import merged, nested
from wbc_controller.settings.resources import PACKAGE_SCHEME, read_text, share_folder, shown
from wbc_controller.settings.values import LIST, NUMBER

_LARGEST_FILE = 1_000_000  # largest configuration file, characters
_MOST_VALUES = 20_000  # largest number of values of a YAML text, with aliases expanded
_LONGEST_VALUE, _LONGEST_INTEGER = 4096, 32  # longest value and longest integer of a YAML text, characters
_PATHS = ("robot.urdf", "limits.self_collision.srdf")  # keys with paths
_INTEGER = "tag:yaml.org,2002:int"


def find_configuration(name: str) -> Path:
    """Return the path of a shipped configuration or an existing path; else `ConfigurationError`."""
    path = Path(name)
    is_path = path.suffix in (".yaml", ".yml") or len(path.parts) > 1
    if is_path and os.path.isfile(path):
        return path
    shipped = shipped_configurations()
    if not is_path and name in shipped:
        return shipped[name]
    problem = f"configuration file {shown(name)} does not exist" if is_path else f"unknown configuration {shown(name)}"
    choices = valid_choices(path.stem if is_path else name, shipped)
    raise ConfigurationError(f"{problem}; {choices}, or the path of a .yaml file")


def shipped_configurations() -> dict[str, Path]:
    """Return the configuration files of the shipped robots by name."""
    checkout = Path(__file__).resolve().parents[2]
    in_checkout = (checkout / "setup.py").is_file()
    folder = (checkout if in_checkout else share_folder("wbc_controller")) / "config"
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def load_settings(path: Path) -> Settings:
    """Read and validate a ROS 2 parameter file; errors as in `parse_settings`."""
    parameters = read_parameters(read_text(path, str(path), _LARGEST_FILE), str(path))
    return parse_settings(resolve_paths(path, parameters), str(path))


def resolve_paths(path: Path, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``ros__parameters`` with relative paths resolved against the folder of their file."""
    for key in _PATHS:
        value: Any = parameters
        for name in key.split("."):
            value = value.get(name) if isinstance(value, Mapping) else None
        if isinstance(value, str) and value and not value.startswith((PACKAGE_SCHEME, "~", "/")):
            parameters = merged(parameters, nested({key: str(path.absolute().parent / value)}))
    return dict(parameters)


def read_yaml(text: str, source: str, loader: Any = yaml.SafeLoader) -> Any:
    """Read a YAML document as plain values, without constructing too large ones; `source` names it in messages.

    `ConfigurationError` if the text is not valid YAML, too large, or has a duplicate key or recursive alias.
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
        place = f"{source}:{mark.line + 1}" if mark else source
        raise ConfigurationError(f"{place}: not valid YAML: {error.problem or error.context}") from error
    except ConfigurationError:
        raise
    except Exception as error:  # PyYAML's constructors raise any exception
        kind = f"{type(error).__name__}: " if isinstance(error, (LookupError, AttributeError)) else ""
        raise ConfigurationError(f"{source}: not valid YAML: {kind}{' '.join(str(error).split())}") from error


def yaml_line(value: Any) -> str:
    """Return a value as YAML on one line."""
    text = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, allow_unicode=True, width=10**6)
    return text.removesuffix("\n").removesuffix("\n...")


def parse_settings(parameters: Mapping[str, Any], source: str) -> Settings:
    """Validate ``ros__parameters``; `ConfigurationError` has a line per mistake: source, key, value, valid choices."""
    try:
        return Settings.model_validate(parameters)
    except ValidationError as error:
        raise ConfigurationError("\n".join(_explain(problem, source) for problem in error.errors())) from error


def _count(node: yaml.Node, source: str, keys: tuple[str, ...], counts: dict[int, int]) -> int:
    """Check a node for `read_yaml`; return its number of values."""
    place = f"{source}:{node.start_mark.line + 1}"
    if id(node) in counts:
        if not counts[id(node)]:
            raise ConfigurationError(f"{place}: not valid YAML: recursive alias")
        return counts[id(node)]
    counts[id(node)] = 0  # not counted yet
    count = 1
    if isinstance(node, yaml.ScalarNode):
        longest = _LONGEST_INTEGER if node.tag == _INTEGER else _LONGEST_VALUE
        if len(node.value) > longest:
            kind = "integer" if node.tag == _INTEGER else "value"
            raise ConfigurationError(
                f"{place}: {_dotted(keys)}: {kind} with {len(node.value)} characters; at most {longest} are allowed"
            )
    elif isinstance(node, yaml.SequenceNode):
        for value in node.value:
            count += _count(value, source, keys, counts)
    elif isinstance(node, yaml.MappingNode):
        lines: dict[str, int] = {}
        for key_node, value in node.value:
            count += _count(key_node, source, keys, counts)
            key, line = str(key_node.value), key_node.start_mark.line + 1
            if key in lines:  # YAML would use the last one without an error
                problem = f"duplicate key {key!r}, first in line {lines[key]}; remove one"
                raise ConfigurationError(f"{source}:{line}: {_dotted((*keys, key))}: {problem}")
            lines[key] = line
            count += _count(value, source, (*keys, key), counts)
    if count > _MOST_VALUES:
        raise ConfigurationError(f"{place}: {_dotted(keys)}: more than {_MOST_VALUES} values with aliases expanded")
    counts[id(node)] = count
    return count


def _dotted(keys: tuple[str, ...]) -> str:
    return ".".join(keys[2:] if keys[1:2] == ("ros__parameters",) else keys) or "the text"


def read_parameters(text: str, source: str) -> Mapping[str, Any]:
    """Read the ``ros__parameters`` of a ROS 2 parameter file; errors as in `read_yaml`."""
    content = read_yaml(text, source)
    form = f"a ROS 2 parameter file starts with\n  {NODE_NAME}:\n    ros__parameters:"
    if not isinstance(content, dict):
        raise ConfigurationError(f"{source}: contains {type(content).__name__}, expected a mapping; {form}")
    node = content.get(NODE_NAME, content.get("/**"))
    if not isinstance(node, dict):
        found = ", ".join(map(repr, content))
        raise ConfigurationError(f"{source}: missing key {NODE_NAME!r} (found: {found}); {form}")
    parameters = node.get("ros__parameters")
    if not isinstance(parameters, dict):
        raise ConfigurationError(f"{source}: missing mapping 'ros__parameters' in {NODE_NAME}; {form}")
    return parameters


def _locate(location: Sequence[Any]) -> tuple[list[Any], Mapping[str, FieldInfo], FieldInfo | None, Any]:
    """Return the keys of the file, the fields of the last key's section, and the key's field and annotation."""
    keys: list[Any] = []
    fields: Mapping[str, FieldInfo] = {}
    field: FieldInfo | None = None
    kind: Any = Settings
    for part in location:
        if part in (NUMBER, LIST):
            continue
        types = types_of(kind)
        if part in types:
            kind = types[part]
            continue
        keys.append(part)
        if not isinstance(part, int):  # a list has the description of its key
            candidates = (each for each in (kind, *get_args(kind)) if isinstance(each, type))
            section = next((each for each in candidates if issubclass(each, BaseModel)), None)
            fields = section.model_fields if section is not None and get_origin(kind) is not dict else {}
            field = fields.get(str(part))
            kind = get_args(kind)[1] if get_origin(kind) is dict else field and field.annotation
    return keys, fields, field, kind


def types_of(kind: Any) -> dict[str, type[BaseModel]]:
    """Return the sections of tasks or contacts by their value of ``type``; empty for other annotations."""
    members = get_args(get_args(kind)[0]) if get_origin(kind) is Annotated else ()
    return {str(get_args(each.model_fields["type"].annotation)[0]): each for each in members}


def _explain(problem: Any, source: str) -> str:
    location, value = problem["loc"], problem["input"]
    reason = problem["msg"].removeprefix("Value error, ")
    if location[-1:] == ("[key]",):
        return f"{source}: {'.'.join(map(str, location[:-2]))}: {reason}"
    keys, fields, field, annotation = _locate(location)
    key = ".".join(text if (text := str(part)).isprintable() else repr(text) for part in keys)
    about = field.description if field is not None else None
    about = f" ({about.rstrip('.')})" if about else ""
    if problem["type"] == "extra_forbidden":
        return f"{source}: {key}: unknown key; {valid_choices(str(location[-1]), fields)}"
    if problem["type"] == "missing":
        return f"{source}: {key}: missing key{about}"
    if problem["type"] in ("union_tag_invalid", "union_tag_not_found"):
        kind, types = value.get("type") if isinstance(value, dict) else value, types_of(annotation)
        if kind is None:
            return f"{source}: {key}.type: missing key; {valid_choices('', types)}"
        return f"{source}: {key}.type: unknown type {kind!r}; {valid_choices(str(kind), types)}"
    if problem["type"] == "value_error" and isinstance(value, dict):  # from a validator of several keys
        return f"{source}: {key}{'.' if key else ''}{reason}"
    shown = "" if isinstance(value, dict) else f" = {reprlib.repr(value)}"
    return f"{source}: {key}{shown}: {reason[0].lower()}{reason[1:]}{about}"
