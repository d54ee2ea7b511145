"""Writes the tables of fault kinds in docs/faults.md, by the place where they act."""

from __future__ import annotations

from collections.abc import Iterable

from pydantic.fields import FieldInfo

from wbc_controller.simulation.faults.catalogue import COMMON, valid_range
from wbc_controller.simulation.faults.fault import Fault


def faults_table(kinds: Iterable[type[Fault]]) -> str:
    """The table of some kinds, as Markdown."""
    rows = ["| Kind | What happens | Parameters: range (default) |", "|---|---|---|"]
    for kind in kinds:
        said = " ".join((kind.__doc__ or "").split("\n\n")[0].split())
        keys = [key for key in kind.model_fields if key not in COMMON]
        parameters = "; ".join(_described(key, kind.model_fields[key]) for key in keys) or "none"
        rows.append(f"| `{kind.kind()}` | {said} | {parameters} |")
    return "\n".join(rows) + "\n"


def _described(key: str, field: FieldInfo) -> str:
    default = f"{field.default:g}" if isinstance(field.default, float) else repr(field.default).strip("'")
    shown = f" ({default})" if default else ""
    return (
        f"`{key}`, {field.description}: {valid_range(field)}{shown}"
        if valid_range(field)
        else f"`{key}`, {field.description}"
    )


def by_place(kinds: Iterable[type[Fault]]) -> dict[str, list[type[Fault]]]:
    """Kinds by where they act."""
    places: dict[str, list[type[Fault]]] = {}
    for kind in kinds:
        places.setdefault(kind.place, []).append(kind)
    return places
