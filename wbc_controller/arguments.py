"""Checks of arguments of public functions: numbers, arrays of numbers, names and mappings."""

from __future__ import annotations

import math
import numbers
import reprlib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from wbc_controller.errors import InputRefused, valid_choices
from wbc_controller.records import Array


def array_of_numbers(values: Any, what: str) -> Array:
    """Read an array of real numbers, not necessarily finite; `what` names it in errors.

    Raises:
        InputRefused: if a value is not a real number, or the array is masked: masked values are not numbers.
    """
    parts = values if isinstance(values, list | tuple) else [values]
    if any(isinstance(part, np.ma.MaskedArray) for part in parts):
        raise InputRefused(f"{what} is a masked array; fill it first, with numpy.ma.filled")
    try:
        array = np.asarray(values)
        if array.dtype.kind == "O" and all(isinstance(value, numbers.Real) for value in array.flat):
            array = array.astype(np.float64)
        if array.dtype.kind in "iuf":
            return np.asarray(array, dtype=np.float64)
    except Exception as error:  # NumPy calls methods of any object
        raise InputRefused(f"{what} is not an array of numbers: {error}") from error
    raise InputRefused(f"{what} is not an array of numbers: {reprlib.repr(values)}")


def finite(values: Any, what: str) -> Array:
    """Read an array of finite numbers.

    Raises:
        InputRefused: if a value is not a real number, or not finite.
    """
    array = array_of_numbers(values, what)
    if not np.isfinite(array).all():
        raise InputRefused(f"{what} holds a value that is not finite: {shortened(array)}")
    return array


def sized(values: Any, size: int, what: str) -> Array:
    """Read an array of real numbers, (size,), not necessarily finite.

    Raises:
        InputRefused: if a value is not a real number, or the array has another shape.
    """
    array = array_of_numbers(values, what)
    if array.shape != (size,):
        raise InputRefused(f"{what} has the shape {array.shape}; it takes ({size},)")
    return array


def number(value: Any, what: str, lower: float = -math.inf, upper: float = math.inf) -> float:
    """Read a real number within a range; `what` names it in errors.

    Raises:
        InputRefused: if it is not a real number, or outside the range.
    """
    try:
        result = float(value) if isinstance(value, numbers.Real) and not isinstance(value, bool) else math.nan
    except OverflowError:
        result = math.nan
    if not (lower <= result <= upper and math.isfinite(result)):
        valid = "a finite number" if lower == -math.inf else f"from {lower:g} to {upper:g}"
        raise InputRefused(f"{what} must be {valid}, not {reprlib.repr(value)}")
    return result


def name_of(value: Any, choices: Iterable[str], what: str) -> str:
    """Read one of some names; `what` is their kind, such as ``task``.

    Raises:
        InputRefused: if it is not one of them.
    """
    names = tuple(choices)
    if not isinstance(value, str) or value not in names:
        raise InputRefused(f"there is no {what} {reprlib.repr(value)}; {valid_choices(str_of(value), names)}")
    return value


def str_of(value: Any) -> str:
    """Return a short text for a value of any type."""
    return value if isinstance(value, str) else reprlib.repr(value)


def is_mapping_of_names(value: Any) -> bool:
    """Return True for a mapping with texts as keys."""
    return isinstance(value, Mapping) and all(isinstance(key, str) for key in value)


def shortened(array: Array) -> str:
    """Return the first values of an array, for an error message."""
    flat = array.reshape(-1)
    shown = ", ".join(f"{value:g}" for value in flat[:8])
    return f"[{shown}{', …' if flat.size > 8 else ''}]"
