"""Nested dictionaries: from dotted keys, and merged."""

import reprlib
from collections.abc import Mapping, Sequence
from typing import Any

from wbc_controller.errors import ConfigurationError


def nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """Convert dotted keys, also within values, to nested dictionaries, and sequences to lists."""
    if not isinstance(values, Mapping) or not all(isinstance(name, str) for name in values):
        raise ConfigurationError(
            f"{reprlib.repr(values)}: must be a dictionary by dotted key, such as {{'tasks.com.weight': 20.0}}"
        )
    tree: dict[str, Any] = {}
    for name, value in values.items():
        plain, *sections = _to_builtin(value), *reversed(name.split("."))
        for section in sections:
            plain = {section: plain}
        _insert(tree, plain, name)
    return tree


def _insert(tree: dict[str, Any], branch: Mapping[str, Any], name: str, above: str = "") -> None:
    for key, value in branch.items():
        there = tree.get(key)
        if key not in tree:
            tree[key] = value
        elif isinstance(there, dict) and isinstance(value, Mapping):
            _insert(there, value, name, f"{above}{key}.")
        else:
            shown = value if isinstance(there, dict) else there
            raise ConfigurationError(f"parameter {above}{key} = {shown!r}: conflict with parameter {name}")


def _to_builtin(value: Any) -> Any:
    if isinstance(value, Mapping):
        return nested(value)
    if hasattr(value, "mask") and hasattr(value, "tolist"):
        raise ConfigurationError(f"{reprlib.repr(value)}: masked array; fill it with numpy.ma.filled")
    if hasattr(value, "tolist"):  # arrays and numbers of NumPy, array.array
        return value.tolist()
    return list(value) if isinstance(value, Sequence) and not isinstance(value, (str, bytes)) else value


def merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Return a nested dictionary with the values of another one on top."""
    result = dict(base)
    for key, value in over.items():
        below = result.get(key)
        result[key] = merged(below, value) if isinstance(below, Mapping) and isinstance(value, Mapping) else value
    return result
