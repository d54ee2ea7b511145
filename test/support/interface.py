"""The interface that users rely on: commands with their options, keys of the configuration, and topics.

``python test/support/interface.py`` prints it as JSON. `interface_of_d8d35bb.json` was written so by that commit, whose
tables of topics are in ``wbc_controller/wire/topics.py``.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib import import_module
from typing import Any

import click

from wbc_controller.cli import main
from wbc_controller.settings import Settings


def interface(topics_module: str = "wbc_controller.middleware.topics") -> dict[str, list[str]]:
    """Collect all names, sorted."""
    topics = import_module(topics_module)
    return {
        "commands": sorted(_commands(main, "wbc")),
        "configuration": sorted(set(_keys(Settings.model_json_schema()))),
        "topics": sorted(_topics(topics)),
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


def _topics(topics: Any) -> Iterator[str]:
    for table in ("CONTROLLER", "ESTIMATOR", "GUARD", "MOCK"):
        for topic in getattr(topics, f"{table}_TOPICS"):
            qos = f"reliable={topic.qos.reliable} latched={topic.qos.latched} depth={topic.qos.depth}"
            yield f"{table.lower()} {topic.direction.value} {topic.name} {topic.type} {qos}"
    for task, types in topics.TASK_TYPES.items():
        yield from (f"{task} {use} {name}" for use, name in types.items())


if __name__ == "__main__":
    print(json.dumps(interface(), indent=0))
