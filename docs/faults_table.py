"""Lists of fault kinds in docs/faults.md, by affected part."""

from collections.abc import Iterable

from pydantic.fields import FieldInfo

from wbc_controller.simulation.faults.catalogue import COMMON, valid_range
from wbc_controller.simulation.faults.fault import Fault

#: Names explained in the text of the page.
_COMMON_NAMES = ("joint", "actuator", "stream", "link")


def faults_table(kinds: Iterable[type[Fault]]) -> str:
    """Return the Markdown list of some kinds."""
    rows = []
    for kind in kinds:
        said = " ".join((kind.__doc__ or "").split("\n\n")[0].split())
        keys = [key for key in kind.model_fields if key not in COMMON]
        parameters = "; ".join(_describe(key, kind.model_fields[key]) for key in keys)
        rows.append(f"- `{kind.kind()}`: {said}" + (f" {parameters}." if parameters else ""))
    return "\n".join(rows) + "\n"


def _describe(key: str, field: FieldInfo) -> str:
    """Describe a parameter; the page explains `_COMMON_NAMES` once."""
    if key in _COMMON_NAMES:
        return f"`{key}`"
    default = f"{field.default:g}" if isinstance(field.default, float) else repr(field.default).strip("'")
    shown = f" ({default})" if default else ""
    meaning = f", {field.description}" if field.description != key.replace("_", " ") else ""
    return f"`{key}`{meaning}: {valid_range(field)}{shown}" if valid_range(field) else f"`{key}`{meaning}"


def by_place(kinds: Iterable[type[Fault]]) -> dict[str, list[type[Fault]]]:
    """Return the kinds by affected part."""
    places: dict[str, list[type[Fault]]] = {}
    for kind in kinds:
        places.setdefault(kind.place, []).append(kind)
    return places
