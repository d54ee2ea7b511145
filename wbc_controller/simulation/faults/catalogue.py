"""All kinds of fault."""

import reprlib
from collections.abc import Mapping
from dataclasses import astuple
from types import ModuleType
from typing import Any, Literal, get_args, get_origin

import numpy as np
from pydantic import ValidationError
from pydantic.fields import FieldInfo

from wbc_controller.errors import ConfigurationError, valid_choices
from wbc_controller.settings.files import read_yaml
from wbc_controller.simulation.faults import actuators, base_sensors, joint_sensors, messages, world
from wbc_controller.simulation.faults.fault import Fault


def kinds_of(module: ModuleType) -> list[type[Fault]]:
    """Return the kinds of fault of a module in their order: its classes without underscore."""
    classes = [each for each in vars(module).values() if isinstance(each, type) and issubclass(each, Fault)]
    return [each for each in classes if each.__module__ == module.__name__ and each.__name__[0] != "_"]


#: Kinds of fault by name.
KINDS: Mapping[str, type[Fault]] = {
    kind.kind(): kind
    for module in (joint_sensors, base_sensors, messages, actuators, world)
    for kind in kinds_of(module)
}
_WIDE = 15.0  # ratio of a range's ends above which its logarithm is drawn
_MOST = 100  # largest number of faults in one text
_FORM = "a fault is a mapping such as {kind: joint_noise, sigma: 0.01, start: 0.0, duration: 2.0}"
COMMON = ("start", "duration", "seed")


def read_faults(text: str, source: str, *, script: bool = False) -> list[Fault]:
    """Read one fault, or a list; a script has ``at``, the simulated time in s, instead of ``start``."""
    content = read_yaml(text, source)
    entries = content if isinstance(content, list) else [content]
    if len(entries) > _MOST:
        raise ConfigurationError(f"{source}: {len(entries)} faults; at most {_MOST} are allowed")
    return [_read(entry, source if len(entries) == 1 else f"{source}: fault {i}", script)
            for i, entry in enumerate(entries, 1)]  # fmt: skip


def _read(entry: Any, source: str, script: bool) -> Fault:
    if not isinstance(entry, dict):
        raise ConfigurationError(f"{source}: expected a mapping, got {reprlib.repr(entry)}; {_FORM}")
    parameters = {str(key): value for key, value in entry.items()}
    name = parameters.pop("kind", None)
    if not isinstance(name, str) or name not in KINDS:
        raise ConfigurationError(f"{source}: unknown kind {reprlib.repr(name)}; {valid_choices(str(name), KINDS)}")
    if script:
        if "at" not in parameters or "start" in parameters:
            raise ConfigurationError(
                f"{source}: {name}: a script requires 'at', the simulated time in s, instead of 'start'"
            )
        parameters["start"] = parameters.pop("at")
    try:
        return KINDS[name].model_validate(parameters)
    except ValidationError as error:
        problems = [_explain(problem, name) for problem in error.errors()]
        raise ConfigurationError(f"{source}: {'; '.join(problems)}") from error


def _explain(problem: Any, name: str) -> str:
    key = ".".join(map(str, problem["loc"]))
    if problem["type"] == "extra_forbidden":
        return f"{name}: unknown key {key!r}; {valid_choices(key, KINDS[name].model_fields)}"
    field = KINDS[name].model_fields[key]
    reason = problem["msg"][0].lower() + problem["msg"][1:]
    valid = f"{valid_range(field)} ({field.description})"
    return f"{name}.{key} = {reprlib.repr(problem['input'])}: {reason}; valid: {valid}"


def draw(kind: type[Fault], rng: np.random.Generator, **given: Any) -> Fault:
    """Return a fault with random parameters from the ranges of its kind."""
    values: dict[str, Any] = {}
    for key, field in kind.model_fields.items():
        if key in given or key in COMMON:
            continue
        if get_origin(field.annotation) is Literal:
            values[key] = str(rng.choice(get_args(field.annotation)))
        elif field.metadata:
            low, high = _limits(field)
            wide = low > 0.0 and high / low > _WIDE
            value = float(np.exp(rng.uniform(np.log(low), np.log(high))) if wide else rng.uniform(low, high))
            values[key] = round(value) if field.annotation is int else min(max(value, low), high)
    return kind.model_validate({**values, **given})


def valid_range(field: FieldInfo) -> str:
    """Return the valid values of a parameter as text; empty for a name."""
    if get_origin(field.annotation) is Literal:
        return ", ".join(map(str, get_args(field.annotation)))
    if not field.metadata:
        return ""
    extra = field.json_schema_extra
    unit = str(extra.get("unit", "")) if isinstance(extra, dict) else ""
    low, high = _limits(field)
    return f"{low:g} to {high:g} {unit}".rstrip()


def _limits(field: FieldInfo) -> list[float]:
    """Return the limits of a number, the lower one first: ``ge`` or ``gt``, then ``le`` or ``lt``."""
    return [float(limit) for constraint in field.metadata for limit in astuple(constraint)]
