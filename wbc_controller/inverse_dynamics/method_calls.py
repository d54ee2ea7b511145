"""Checked calls of user-defined methods.

Wrong shapes would make compiled code write outside its memory. All functions raise `MethodError`.
"""

import math
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from wbc_controller.errors import MethodError
from wbc_controller.inverse_dynamics.arrays import sum_of_squares
from wbc_controller.records import Array

Shape = tuple[int, ...]
_FLOAT64 = np.dtype(np.float64)
_SHOWN = 80  # longest value in an error message


class Named(Protocol):
    """A task, contact or limit."""

    @property
    def full_name(self) -> str:
        """Kind and name, e.g. ``task 'com'``."""


def call(owner: Named, method: str, *arguments: Any) -> Any:
    """Call a method; translate its exception to a `MethodError`."""
    try:
        return getattr(owner, method)(*arguments)
    except Exception as error:
        raise raised(owner, method, error) from error


def raised(owner: Named, method: str, error: Exception) -> MethodError:
    """Return the error for an exception in a method: a `MethodError` itself."""
    if isinstance(error, MethodError):
        return error
    return MethodError(f"{_title(owner, method)} raised {type(error).__name__}: {error}")


def array_from(owner: Named, method: str, shape: Shape, *arguments: Any) -> Array:
    """Call a method that returns an array of finite numbers, and return it as float64."""
    array = checked(owner, method, call(owner, method, *arguments), shape)
    require_finite_result(owner, method, array)
    return array


def arrays_from(owner: Named, method: str, shapes: Sequence[Shape], *arguments: Any) -> tuple[Array, ...]:
    """Call a method that returns several arrays of finite numbers."""
    arrays = arrays_of(owner, method, call(owner, method, *arguments), shapes)
    require_finite_result(owner, method, *arrays)
    return arrays


def arrays_of(owner: Named, method: str, values: Any, shapes: Sequence[Shape]) -> tuple[Array, ...]:
    """Check the arrays returned by a method."""
    if not isinstance(values, tuple | list) or len(values) != len(shapes):
        raise MethodError(f"{_title(owner, method)} returned {_short(values)}, expected {len(shapes)} arrays")
    return tuple(checked(owner, method, value, shape) for value, shape in zip(values, shapes, strict=True))


def bounds_from(owner: Named, method: str, size: int, *arguments: Any) -> tuple[Array, Array]:
    """Call a method that returns bounds (size,): lower ≤ upper, possibly infinite."""
    bounds = call(owner, method, *arguments)
    if not isinstance(bounds, tuple | list) or len(bounds) != 2:
        raise MethodError(f"{_title(owner, method)} returned {_short(bounds)}, expected lower and upper bounds")
    lower, upper = (checked(owner, method, bound, (size,)) for bound in bounds)
    require_bounds(owner, method, lower, upper)
    return lower, upper


def require_bounds(owner: Named, method: str, lower: Array, upper: Array) -> None:
    """Require lower ≤ upper, lower < inf and upper > -inf, without NaN."""
    right = (lower <= upper) & (lower < np.inf) & (upper > -np.inf)
    if not right.all():
        i = int(np.argmin(right))
        raise MethodError(
            f"{_title(owner, method)} returned the bounds {lower[i]:g} and {upper[i]:g} at index {i}, expected "
            "lower ≤ upper (-inf and inf for no bound)"
        )


def require_finite_result(owner: Named, method: str, *arrays: Array) -> None:
    """Require finite arrays as result of a method."""
    for array in arrays:
        if not np.isfinite(array).all():
            raise MethodError(f"{_title(owner, method)} returned {_short(array)}, expected finite numbers")


def require_finite(owner: Named, method: str, name: str, written: Array) -> None:
    """Require finite values written by a method."""
    if not is_finite(written) and not np.isfinite(written).all():
        raise MethodError(f"{_title(owner, method)} wrote {_short(written)} to {name}, expected finite numbers")


def is_finite(values: Array) -> bool:
    """Return True for a finite sum of squares: no NaN, infinity or value above 1e150."""
    return math.isfinite(sum_of_squares(values))


def checked(owner: Named, method: str, value: Any, shape: Shape) -> Array:
    """Check type and shape of an array returned by a method; fast."""
    if type(value) is np.ndarray and value.dtype is _FLOAT64 and value.shape == shape:
        return value
    try:
        array = np.asarray(value)
    except ValueError:  # lists of different lengths
        array = np.empty(0, dtype=np.object_)
    if array.dtype.kind not in "iuf" or isinstance(value, np.ma.MaskedArray):
        raise MethodError(
            f"{_title(owner, method)} returned {_short(value)}, expected an array of numbers of shape {shape}"
        )
    if array.shape != shape:
        raise MethodError(f"{_title(owner, method)} returned shape {array.shape}, expected {shape}")
    return np.asarray(array, dtype=np.float64)


def _title(owner: Named, method: str) -> str:
    return f"{owner.full_name}: {type(owner).__name__}.{method}()"


def _short(value: Any) -> str:
    text = " ".join(repr(value.tolist() if isinstance(value, np.ndarray) else value).split())
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 2]} …"
