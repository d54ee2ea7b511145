"""Argument checks of public functions."""

import math
import numbers
import reprlib
from typing import Any

import numpy as np

from wbc_controller.errors import InputRefused
from wbc_controller.records import Array

_QUATERNION_TOLERANCE = 1.0e-2  # of the norm


def array_of_numbers(values: Any, subject: str) -> Array:
    """Return an array of real numbers, infinity or NaN; `subject` names it in errors."""
    parts = values if isinstance(values, list | tuple) else [values]
    if any(isinstance(part, np.ma.MaskedArray) for part in parts):
        raise InputRefused(f"{subject} is a masked array; fill it with numpy.ma.filled")
    if any(isinstance(part, bool | np.bool_) for part in parts):  # NumPy converts them beside numbers
        raise InputRefused(f"{subject} is not an array of numbers: {reprlib.repr(values)}")
    try:
        array = np.asarray(values)
        if array.dtype.kind == "O" and all(isinstance(value, numbers.Real) for value in array.flat):
            array = array.astype(np.float64)
        if array.dtype.kind in "iuf":
            return np.asarray(array, dtype=np.float64)
    except Exception as error:  # NumPy calls methods of any object
        raise InputRefused(f"{subject} is not an array of numbers: {error}") from error
    raise InputRefused(f"{subject} is not an array of numbers: {reprlib.repr(values)}")


def finite(values: Any, subject: str) -> Array:
    """Return an array of finite numbers."""
    array = array_of_numbers(values, subject)
    if not np.isfinite(array).all():
        raise InputRefused(f"{subject} is not finite: {shortened(array)}")
    return array


def sized(values: Any, size: int, subject: str) -> Array:
    """Return an array of real numbers, infinity or NaN, (size,)."""
    array = array_of_numbers(values, subject)
    if array.shape != (size,):
        raise InputRefused(f"{subject} has shape {array.shape}, expected ({size},)")
    return array


def number(value: Any, subject: str, lower: float = -math.inf, upper: float = math.inf) -> float:
    """Return a real number within a range."""
    try:
        result = float(value) if isinstance(value, numbers.Real) and not isinstance(value, bool) else math.nan
    except OverflowError:
        result = math.nan
    if not (lower <= result <= upper and math.isfinite(result)):
        valid = "a finite number" if lower == -math.inf else f"from {lower:g} to {upper:g}"
        raise InputRefused(f"{subject} must be {valid}, not {reprlib.repr(value)}")
    return result


def str_of(value: Any) -> str:
    """Return a string unchanged, and a short `repr` of any other value."""
    return value if isinstance(value, str) else reprlib.repr(value)


def shortened(array: Array) -> str:
    """Format the first eight values of an array."""
    flat = array.reshape(-1)
    shown = ", ".join(f"{value:g}" for value in flat[:8])
    return f"[{shown}{', …' if flat.size > 8 else ''}]"


def unit_quaternion(values: Array, what: str) -> Array:
    """Normalize a quaternion; raises `InputRefused` for a norm other than 1 within tolerance."""
    norm = math.hypot(*values.tolist())
    if not (abs(norm - 1.0) <= _QUATERNION_TOLERANCE):
        raise InputRefused(f"{what}{shortened(values)} is not a unit quaternion (norm {norm:.3g})")
    return values / norm
