"""Messages as YAML text, with six digits and arrays in one line."""

from collections.abc import Iterator
from typing import Any

import numpy as np

_KEY_VALUE = "diagnostic_msgs/msg/KeyValue"  # type of diagnostic entries, printed in one line


def as_text(content: Any) -> str:
    """Return a message as YAML."""
    return "\n".join(_fields(content, ""))


def _fields(content: Any, indent: str) -> Iterator[str]:
    for name, value in vars(content).items():
        if name == "__msgtype__":
            continue
        if _is_message(value):
            axes = [key for key in vars(value) if key != "__msgtype__"]
            if set(axes) <= set("xyzw"):
                yield f"{indent}{name}: {{{', '.join(f'{key}: {_scalar(getattr(value, key))}' for key in axes)}}}"
            else:
                yield f"{indent}{name}:"
                yield from _fields(value, f"{indent}  ")
        elif isinstance(value, list) and value and _is_message(value[0]):
            yield f"{indent}{name}:"
            for item in value:
                yield from _item(item, indent)
        elif isinstance(value, list | tuple | np.ndarray):
            yield f"{indent}{name}: [{', '.join(map(_scalar, value))}]"
        else:
            yield f"{indent}{name}: {_scalar(value)}"


def _item(item: Any, indent: str) -> Iterator[str]:
    if item.__msgtype__ == _KEY_VALUE:
        yield f"{indent}  {item.key}: {item.value}"
        return
    for i, line in enumerate(_fields(item, "")):
        yield f"{indent}{'- ' if i == 0 else '  '}{line}"


def _is_message(value: Any) -> bool:
    return hasattr(value, "__msgtype__")


def _scalar(value: Any) -> str:
    if isinstance(value, float | np.floating):
        return f"{float(value):.6g}"
    return str(value)
