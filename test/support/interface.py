"""The interface that users rely on: commands with their options, keys of the configuration, topics, Python names.

``python test/support/interface.py`` prints it as JSON. `interface_of_0.1.0.json` is the interface of that release: see
docs/stability.md for the next one.
"""

import ast
import inspect
import json
import textwrap
from collections.abc import Iterator
from enum import Enum
from importlib import import_module
from typing import Any

import click

import wbc_controller
from wbc_controller.cli import main
from wbc_controller.middleware import topics
from wbc_controller.settings import Settings

#: Modules with public names, besides `wbc_controller`.
MODULES = tuple(f"inverse_dynamics.{name}" for name in ("tasks", "contacts", "limits", "solvers"))


def interface() -> dict[str, list[str]]:
    """Collect all names, sorted."""
    return {
        "commands": sorted(_commands(main, "wbc")),
        "configuration": sorted(set(_keys(Settings.model_json_schema()))),
        "topics": sorted(_topics()),
        "python": sorted(set(_python())),
    }


def _commands(command: click.Command, path: str) -> Iterator[str]:
    yield path
    for parameter in command.params:
        yield from (f"{path} {name}" for name in (*parameter.opts, *parameter.secondary_opts))
        if isinstance(parameter.type, click.Choice):
            yield from (f"{path} {parameter.opts[0]}={choice}" for choice in parameter.type.choices)
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            assert below is not None
            yield from _commands(below, f"{path} {name}")


def _keys(schema: dict[str, Any], node: dict[str, Any] | None = None, path: str = "") -> Iterator[str]:
    """Keys and choices below a node of a JSON schema, as ``tasks.<com>.weight`` and ``solver.name=osqp``."""
    node = schema if node is None else node
    if "$ref" in node:
        node = schema["$defs"][node["$ref"].rpartition("/")[2]]
        if "type" in (kind := node.get("properties", {})) and "const" in kind["type"]:
            path += f".<{kind['type']['const']}>"
    for choice in node.get("enum", []):
        yield f"{path}={choice}"
    for name, below in node.get("properties", {}).items():
        yield f"{path}.{name}".lstrip(".")
        yield from _keys(schema, below, f"{path}.{name}".lstrip("."))
    inner = [*node.get("anyOf", []), *node.get("oneOf", []), *node.get("prefixItems", [])]
    inner += [node[key] for key in ("items", "additionalProperties") if isinstance(node.get(key), dict)]
    for below in inner:
        yield from _keys(schema, below, path)


def _topics() -> Iterator[str]:
    for table in ("CONTROLLER", "ESTIMATOR", "GUARD", "MOCK"):
        for topic in getattr(topics, f"{table}_TOPICS"):
            qos = f"reliable={topic.qos.reliable} latched={topic.qos.latched} depth={topic.qos.depth}"
            yield f"{table.lower()} {topic.direction.value} {topic.name} {topic.type} {qos}"
    for task, types in topics.TASK_TYPES.items():
        yield from (f"{task} {use} {name}" for use, name in types.items())


def _python() -> Iterator[str]:
    """Exported names; of the classes and functions of `wbc_controller` also members and parameters."""
    for module in MODULES:
        yield from (f"{module}.{name}" for name in import_module(f"wbc_controller.{module}").__all__)
    for name in wbc_controller.__all__:
        value = getattr(wbc_controller, name)
        yield name
        yield from _parameters(name, value)
        if not inspect.isclass(value):
            continue
        fields = getattr(value, "__dataclass_fields__", ())
        for member in getattr(value, "__members__", {*dir(value), *fields, *_attributes(value)}):
            if not member.startswith("_") and not hasattr(Exception, member):
                yield f"{name}.{member}"
                yield from _parameters(f"{name}.{member}", getattr(value, member, None))


def _attributes(kind: type) -> Iterator[str]:
    """Attributes that the methods of a class and of its bases assign."""
    for base in kind.__mro__:
        if base.__module__.startswith("wbc_controller."):
            for node in ast.walk(ast.parse(textwrap.dedent(inspect.getsource(base)))):
                match node:
                    case ast.Attribute(value=ast.Name("self"), attr=name, ctx=ast.Store()):
                        yield name


def _parameters(name: str, value: Any) -> Iterator[str]:
    function = value.__init__ if inspect.isclass(value) and not issubclass(value, Enum) else value
    if inspect.isfunction(function) or inspect.ismethod(function):
        public = (parameter for parameter in inspect.signature(function).parameters if not parameter.startswith("_"))
        yield from (f"{name}({parameter})" for parameter in public if parameter != "self")


if __name__ == "__main__":
    print(json.dumps(interface(), indent=0))
