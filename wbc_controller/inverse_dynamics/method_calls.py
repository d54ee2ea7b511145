"""Calls of task, contact and limit methods, which users may override; errors name the class and the method.

Returned arrays enter compiled code and the quadratic program. Unchecked, a wrong shape would be broadcast, or compiled
code would write outside its memory.
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
#: Largest length of a value in an error message.
_SHOWN = 80


class Named(Protocol):
    """A task, contact or limit."""

    @property
    def full_name(self) -> str:
        """Kind and name, such as ``task 'com'``."""


def call(owner: Named, method: str, *arguments: Any) -> Any:
    """Call a method of a task, contact or limit.

    Raises:
        MethodError: if the method raises an exception; the message names class and method.
    """
    try:
        return getattr(owner, method)(*arguments)
    except MethodError:
        raise
    except Exception as error:
        raise raised(owner, method, error) from error


def raised(owner: Named, method: str, error: Exception) -> MethodError:
    """Return the error for a method that raised an exception."""
    return MethodError(f"{_title(owner, method)} raised {type(error).__name__}: {error}")


def array_from(owner: Named, method: str, shape: Shape, *arguments: Any) -> Array:
    """Call a method that returns one array, and return it as float64 after checking its shape.

    Raises:
        MethodError: as `call`; or for another shape, non-numeric values, NaN or infinity.
    """
    array = checked(owner, method, call(owner, method, *arguments), shape)
    require_finite_result(owner, method, array)
    return array


def arrays_from(owner: Named, method: str, shapes: Sequence[Shape], *arguments: Any) -> tuple[Array, ...]:
    """Call a method that returns a tuple of arrays, and check each as in `array_from`.

    Raises:
        MethodError: as `array_from`, or for another number of arrays than `shapes`.
    """
    arrays = arrays_of(owner, method, call(owner, method, *arguments), shapes)
    require_finite_result(owner, method, *arrays)
    return arrays


def arrays_of(owner: Named, method: str, values: Any, shapes: Sequence[Shape]) -> tuple[Array, ...]:
    """Check number, types and shapes of the arrays returned by a method.

    Raises:
        MethodError: as `arrays_from`.
    """
    if not isinstance(values, tuple | list) or len(values) != len(shapes):
        raise MethodError(f"{_title(owner, method)} returned {_short(values)}, expected {len(shapes)} arrays")
    return tuple(checked(owner, method, value, shape) for value, shape in zip(values, shapes, strict=True))


def bounds_of(owner: Named, method: str, bounds: Any, size: int) -> tuple[Array, Array]:
    """Check the lower and upper bounds (size,) returned by a method; they may be infinite.

    The same object is returned if it needs no conversion, so that the caller can recognize it in the next cycle.

    Raises:
        MethodError: as `arrays_of`; or if a bound is NaN or a lower bound exceeds its upper bound.
    """
    if not isinstance(bounds, tuple | list) or len(bounds) != 2:
        raise MethodError(f"{_title(owner, method)} returned {_short(bounds)}, expected lower and upper bounds")
    lower, upper = (checked(owner, method, bound, (size,)) for bound in bounds)
    require_bounds(owner, method, lower, upper)
    if isinstance(bounds, tuple) and lower is bounds[0] and upper is bounds[1]:
        return bounds
    return lower, upper


def require_bounds(owner: Named, method: str, lower: Array, upper: Array) -> None:
    """Require lower ≤ upper, lower < inf and upper > -inf, without NaN.

    Raises:
        MethodError: with the first invalid pair of bounds.
    """
    right = (lower <= upper) & (lower < np.inf) & (upper > -np.inf)
    if not right.all():
        i = int(np.argmin(right))
        raise MethodError(
            f"{_title(owner, method)} returned the bounds {lower[i]:g} and {upper[i]:g} at index {i}, expected "
            "lower ≤ upper (-inf and inf for no bound)"
        )


def require_finite_result(owner: Named, method: str, *arrays: Array) -> None:
    """Require finite arrays as results of a method.

    Raises:
        MethodError: for NaN or infinity.
    """
    for array in arrays:
        if not np.isfinite(array).all():
            raise MethodError(f"{_title(owner, method)} returned {_short(array)}, expected finite numbers")


def require_finite(owner: Named, method: str, name: str, written: Array) -> None:
    """Require finite values in an array that a method wrote in place.

    Raises:
        MethodError: for NaN or infinity.
    """
    if not is_finite(written) and not np.isfinite(written).all():
        raise MethodError(f"{_title(owner, method)} wrote {_short(written)} to {name}, expected finite numbers")


def is_finite(values: Array) -> bool:
    """Return True if the sum of squares is finite, i.e. without NaN, infinity and values beyond 1e150."""
    return math.isfinite(sum_of_squares(values))


def checked(owner: Named, method: str, value: Any, shape: Shape) -> Array:
    """Check type and shape of an array returned by a method; cheap enough for every cycle.

    Raises:
        MethodError: for a non-numeric value or another shape.
    """
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
