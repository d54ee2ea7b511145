"""Calls of the methods of tasks, contacts and limits, which users may define; errors name the class and the method.

Arrays from these methods go into compiled code and into the arrays of the quadratic program. A wrong shape would be
broadcast there, or would let compiled code write outside of its memory.
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
#: Longest value in an error message.
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
    """The error of a method that has raised an exception."""
    return MethodError(f"{_title(owner, method)} raised {type(error).__name__}: {error}")


def array_from(owner: Named, method: str, shape: Shape, *arguments: Any) -> Array:
    """Call a method that returns one array, and check its shape; returns float64, converted from integers or lists.

    Raises:
        MethodError: as `call`, and if the array has another shape, is not numeric, or contains NaN or infinity.
    """
    array = checked(owner, method, call(owner, method, *arguments), shape)
    require_finite_result(owner, method, array)
    return array


def arrays_from(owner: Named, method: str, shapes: Sequence[Shape], *arguments: Any) -> tuple[Array, ...]:
    """Call a method that returns a tuple of arrays, and check each as `array_from` does.

    Raises:
        MethodError: as `array_from`, and if the method does not return as many arrays as `shapes`.
    """
    arrays = arrays_of(owner, method, call(owner, method, *arguments), shapes)
    require_finite_result(owner, method, *arrays)
    return arrays


def arrays_of(owner: Named, method: str, values: Any, shapes: Sequence[Shape]) -> tuple[Array, ...]:
    """Check number, types and shapes of the arrays that a method has returned.

    Raises:
        MethodError: as `arrays_from`.
    """
    if not isinstance(values, tuple | list) or len(values) != len(shapes):
        raise MethodError(f"{_title(owner, method)} returned {_short(values)}, expected {len(shapes)} arrays")
    return tuple(checked(owner, method, value, shape) for value, shape in zip(values, shapes, strict=True))


def bounds_of(owner: Named, method: str, bounds: Any, size: int) -> tuple[Array, Array]:
    """Check the lower and upper bounds that a method has returned, both (size,); they may be infinite.

    An object that needs no conversion is returned itself, so that the caller can recognize it in the next cycle.

    Raises:
        MethodError: as `arrays_of`, and if a bound is NaN, or a lower bound is above its upper bound.
    """
    if not isinstance(bounds, tuple | list) or len(bounds) != 2:
        raise MethodError(f"{_title(owner, method)} returned {_short(bounds)}, expected lower and upper bounds")
    lower, upper = (checked(owner, method, bound, (size,)) for bound in bounds)
    require_bounds(owner, method, lower, upper)
    if isinstance(bounds, tuple) and lower is bounds[0] and upper is bounds[1]:
        return bounds
    return lower, upper


def require_bounds(owner: Named, method: str, lower: Array, upper: Array) -> None:
    """Require lower ≤ upper, neither NaN, no lower bound inf and no upper bound -inf.

    Raises:
        MethodError: with the first pair of bounds that does not meet this.
    """
    right = (lower <= upper) & (lower < np.inf) & (upper > -np.inf)
    if not right.all():
        i = int(np.argmin(right))
        raise MethodError(
            f"{_title(owner, method)} gave the bounds {lower[i]:g} and {upper[i]:g} at index {i}, expected a lower "
            "bound that is not above the upper one (-inf and inf for no bound)"
        )


def require_finite_result(owner: Named, method: str, *arrays: Array) -> None:
    """Require finite numbers in arrays that a method has returned.

    Raises:
        MethodError: if there is NaN or infinity.
    """
    for array in arrays:
        if not np.isfinite(array).all():
            raise MethodError(f"{_title(owner, method)} returned {_short(array)}, expected finite numbers")


def require_finite(owner: Named, method: str, name: str, written: Array) -> None:
    """Require finite numbers in an array that a method has written in place.

    Raises:
        MethodError: if there is NaN or infinity.
    """
    if not is_finite(written) and not np.isfinite(written).all():
        raise MethodError(f"{_title(owner, method)} wrote {_short(written)} to {name}, expected finite numbers")


def is_finite(values: Array) -> bool:
    """Whether the sum of the squares is finite: not if there is NaN, infinity, or a number beyond 1e150."""
    return math.isfinite(sum_of_squares(values))


def checked(owner: Named, method: str, value: Any, shape: Shape) -> Array:
    """Check type and shape of an array that a method has returned; cheap, for every cycle.

    Raises:
        MethodError: if it is not an array of numbers, or has another shape.
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
