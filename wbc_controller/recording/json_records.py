"""Records as JSON, bit for bit."""

import base64
import dataclasses
import enum
import json
import math
import reprlib
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from wbc_controller import records
from wbc_controller.inverse_dynamics.references.changes import Change
from wbc_controller.inverse_dynamics.references.trajectories import Knot, Ramp, SoftRamp, Trajectory, TuningRamp
from wbc_controller.records import Array, Mode
from wbc_controller.walking import biped, footsteps, swing_kernels, terrain, weight_transfer
from wbc_controller.walking.gait import Phase

#: Valid records of a recording.
_RECORDS: Mapping[str, Callable[..., Any]] = {
    kind.__name__: kind
    for kind in (
        *get_args(Change), records.ChangeSettings, records.Fault, footsteps.Footstep, footsteps.Goal, terrain.Ground,
        records.Infeasibility, Knot, swing_kernels.Landing, biped.LiftOff, footsteps.NominalStep, records.Prediction,
        Ramp, records.Reference, records.RobotState, SoftRamp, footsteps.Stance, biped.Step, records.Tuning, TuningRamp,
        footsteps.Velocity, weight_transfer.WeightTransfer,
    )
}  # fmt: skip


def to_json(value: Any) -> str:
    """Return a record as one line of JSON; other objects raise `TypeError`."""
    return json.dumps(_to_plain(value), separators=(",", ":"), allow_nan=False)


def from_json(text: str) -> Any:
    """Read the result of `to_json`, with sequences as lists; otherwise raise `ValueError`."""
    try:
        return json.loads(text, object_hook=_from_plain)
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError) as error:
        raise ValueError(f"not a value of a recording: {type(error).__name__}: {error}") from error


def require_types(values: Any, types: Mapping[str, Any], what: str, optional: Mapping[str, Any] | None = None) -> None:
    """Check the types of a mapping named `what`; raise `ValueError`."""
    if not isinstance(values, Mapping):
        raise ValueError(f"{what} is {reprlib.repr(values)}, not a mapping")
    missing = [name for name in types if name not in values]
    if missing:
        raise ValueError(f"{what} has no {missing[0]!r}")
    for name, kind in {**types, **(optional or {})}.items():
        if name in values and not _has_type(values[name], kind):
            valid = kind.__name__ if isinstance(kind, type) and not get_origin(kind) else kind
            raise ValueError(f"{what}: {name!r} is {reprlib.repr(values[name])}, not {valid}")


def _has_type(value: Any, kind: Any) -> bool:
    outer, inner = get_origin(kind), get_args(kind)
    if kind is Any:
        return True
    if kind in (float, int):
        return isinstance(value, kind | int) and not isinstance(value, bool)
    if outer in (Union, UnionType):
        return any(_has_type(value, each) for each in inner)
    if outer in (np.ndarray, get_origin(Array)):  # from NumPy 2.5 on Python 3.12 on, an alias
        return isinstance(value, np.ndarray | float)  # 0-d arrays are written as numbers
    if outer in (tuple, list, Sequence):
        return isinstance(value, list | tuple) and all(_has_type(each, inner[0]) for each in value)
    if outer is Mapping:
        pairs = value.items() if isinstance(value, Mapping) else [(None, None)]
        return all(_has_type(key, inner[0]) and _has_type(each, inner[1]) for key, each in pairs)
    return isinstance(value, NoneType if kind is None else kind)


_types_of = cache(get_type_hints)


def _to_plain(value: Any) -> Any:
    if value is None or (isinstance(value, bool | int | str) and not isinstance(value, enum.Enum)):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else {"$float": repr(float(value))}
    if isinstance(value, np.ndarray):
        # The memory order affects the last bit of products.
        order: Literal["F", "C"] = "F" if value.flags.fnc else "C"
        data = base64.b64encode(value.tobytes(order)).decode("ascii")
        return {"$array": data, "type": value.dtype.str, "shape": list(value.shape), "order": order}
    if isinstance(value, Mode):
        return {"$mode": value.value}
    if isinstance(value, Phase):
        return {"$phase": value.value}
    if isinstance(value, complex):
        return {"$complex": [value.real, value.imag]}
    if isinstance(value, Trajectory):
        return {"$trajectory": [_to_plain(knot) for knot in value.knots]}
    if isinstance(value, Mapping):
        if all(isinstance(key, str) and key[:1] != "$" for key in value):
            return {key: _to_plain(each) for key, each in value.items()}
        return {"$map": [[_to_plain(key), _to_plain(each)] for key, each in value.items()]}
    if isinstance(value, list | tuple):
        return [_to_plain(each) for each in value]
    name = type(value).__name__
    if name not in _RECORDS:
        raise TypeError(f"a recording cannot contain a {name}; valid: {', '.join(_RECORDS)}")
    return {"$record": name, **{f.name: _to_plain(getattr(value, f.name)) for f in dataclasses.fields(value)}}


def _from_plain(plain: dict[str, Any]) -> Any:
    """Return the value of a JSON object, whose parts are values already."""
    if "$float" in plain:
        return float(plain["$float"])
    if "$array" in plain:
        kind = np.dtype(plain["type"])
        if kind.kind not in "bif" or not kind.itemsize:
            raise ValueError(f"array has the type {plain['type']!r}; valid: numeric types")
        values = np.frombuffer(base64.b64decode(plain["$array"]), dtype=kind)
        array = values.reshape(plain["shape"], order=plain.get("order", "C")).copy("K")
        array.setflags(write=False)
        return array
    if "$mode" in plain:
        return Mode(plain["$mode"])
    if "$phase" in plain:
        return Phase(plain["$phase"])
    if "$complex" in plain:
        return complex(*plain["$complex"])
    if "$trajectory" in plain:
        knots = plain["$trajectory"]
        if not knots or not _has_type(knots, list[Knot]):
            raise ValueError("trajectory has no points, or invalid points")
        return Trajectory(knots)
    if "$map" in plain:
        return dict(plain["$map"])
    if "$record" not in plain:
        return plain
    name = plain.pop("$record")
    record = _RECORDS[name]
    fields = {key: tuple(each) if isinstance(each, list) else each for key, each in plain.items()}
    require_types(fields, _types_of(record), name)
    return record(**fields)
