"""Small arrays, fast: what NumPy does in one call as well, and why it is not called here.

A cycle makes some hundred calls on arrays of a few dozen numbers, where the price of a NumPy call is its overhead, and
that differs by kind. ``python benchmarks/small_arrays.py`` measures each function below against the plain call; on one
machine, for 30 numbers, NumPy took for `smallest` 3.4 times as long, for `all_true` 3.1, for `all_finite` 1.9, for
`clipped` 2.2, for `solved` 1.5, for `sum_of_squares` 2.1 and for `as_slice` 1.3. Reductions are slow, the index of an
extremum is not; `numpy.clip` and `numpy.linalg.solve` are Python around what is called here.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg.lapack import dgesv

Array = npt.NDArray[np.float64]


def as_slice(index: np.ndarray) -> np.ndarray | slice:
    """Give an index array, (k,), as a slice where its entries follow each other: it reads as a view, without a copy."""
    if len(index) and (np.diff(index) == 1).all():
        return slice(int(index[0]), int(index[-1]) + 1)
    return index


def smallest(values: np.ndarray) -> Any:
    """The smallest of some values; NaN where one is NaN. There has to be one."""
    return values.item(values.argmin())


def largest(values: np.ndarray) -> Any:
    """The largest of some values; NaN where one is NaN. There has to be one."""
    return values.item(values.argmax())


def all_true(flags: np.ndarray) -> bool:
    """Whether all of some flags are true. There has to be one."""
    return bool(smallest(flags))


def all_finite(values: Array) -> bool:
    """Whether no value is infinite or NaN. There has to be one."""
    return bool(smallest(values) > -math.inf and largest(values) < math.inf)


def clipped(values: Array, lower: Array | float, upper: Array | float) -> Array:
    """Values within bounds; the upper one has the last word, and NaN stays."""
    return np.asarray(np.minimum(np.maximum(values, lower), upper))


def solved(A: Array, b: Array) -> Array:
    """X with A x = b, for A (n, n) that is regular; A and b are left alone."""
    x: Array = dgesv(A, b)[2]
    return x


def sum_of_squares(values: Array) -> float:
    """Σ vᵢ²: infinite or NaN where a value is, or where one is beyond 1e150."""
    return float(np.vdot(values, values))
