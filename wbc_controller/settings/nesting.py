"""Nested dictionaries of settings: from dotted keys, and one put over another."""

from __future__ import annotations

import reprlib
from collections.abc import Mapping, Sequence
from typing import Any

from wbc_controller.errors import ConfigurationError


def nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """Turn dotted keys into nested dictionaries, as they stand in a configuration file; sequences become lists.

    A value may be a dictionary with dotted keys itself.

    Raises:
        ConfigurationError: if a key is not a text, a value is a masked array, or one key has both a value and keys
            below it.
    """
    if not isinstance(values, Mapping) or not all(isinstance(name, str) for name in values):
        raise ConfigurationError(
            f"{reprlib.repr(values)}: values are given as a dictionary by dotted key, such as "
            "{'tasks.com.weight': 20.0}"
        )
    tree: dict[str, Any] = {}
    for name, value in values.items():
        plain, *sections = _plain(value), *reversed(name.split("."))
        for section in sections:
            plain = {section: plain}
        _graft(tree, plain, name)
    return tree


def _graft(tree: dict[str, Any], branch: Mapping[str, Any], name: str, above: str = "") -> None:
    """Put a branch into a tree where nothing stands yet; the order is that in which keys come first."""
    for key, value in branch.items():
        there = tree.get(key)
        if key not in tree:
            tree[key] = value
        elif isinstance(there, dict) and isinstance(value, Mapping):
            _graft(there, value, name, f"{above}{key}.")
        else:
            shown = value if isinstance(there, dict) else there
            raise ConfigurationError(f"parameter {above}{key} = {shown!r}: there is a parameter {name} too")


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return nested(value)
    if hasattr(value, "mask") and hasattr(value, "tolist"):
        raise ConfigurationError(f"{reprlib.repr(value)}: a masked array; fill it first, with numpy.ma.filled")
    if hasattr(value, "tolist"):  # arrays and numbers of NumPy, array.array
        return value.tolist()
    return list(value) if isinstance(value, Sequence) and not isinstance(value, (str, bytes)) else value


def merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Put one nested dictionary over another."""
    result = dict(base)
    for key, value in over.items():
        below = result.get(key)
        result[key] = merged(below, value) if isinstance(below, Mapping) and isinstance(value, Mapping) else value
    return result
