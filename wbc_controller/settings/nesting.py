"""Nested dictionaries of settings: from dotted keys, and one put over another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from wbc_controller.errors import ConfigurationError


def nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """Turn dotted keys into nested dictionaries, as they stand in a configuration file.

    Args:
        values: by dotted key, such as ``tasks.com.weight``; a value may be a dictionary with dotted keys itself. Arrays
            and other sequences become lists.

    Raises:
        ConfigurationError: where one key has both a value and keys below it.
    """
    tree: dict[str, Any] = {}
    for name, value in sorted(values.items()):
        *sections, key = name.split(".")
        branch = tree
        for depth, section in enumerate(sections):
            branch = branch.setdefault(section, {})
            if not isinstance(branch, dict):
                upper = ".".join(sections[: depth + 1])
                raise ConfigurationError(f"parameter {upper} = {values[upper]!r}: there is a parameter {name} too")
        branch[key] = _plain(value)
    return tree


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return nested(value)
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
