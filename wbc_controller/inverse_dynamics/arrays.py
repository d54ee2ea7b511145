"""Slices, and fast NumPy equivalents for small arrays (``benchmarks/small_arrays.py``)."""

import math
from collections.abc import Iterable
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg.lapack import dgesv

Array = npt.NDArray[np.float64]


def as_slice(index: np.ndarray) -> np.ndarray | slice:
    """Convert consecutive indices (k,) to a slice, for views instead of copies."""
    if len(index) and (np.diff(index) == 1).all():
        return slice(int(index[0]), int(index[-1]) + 1)
    return index


def consecutive(sizes: Iterable[int], start: int = 0) -> list[slice]:
    """Return consecutive slices of given sizes."""
    return [slice(*ends) for ends in pairwise(accumulate(sizes, initial=start))]


def cross(a: Array, b: Array) -> Array:
    """Return a × b, (3,)."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def smallest(values: np.ndarray) -> Any:
    """Return the smallest value of a non-empty array, or NaN."""
    return values.item(values.argmin())


def largest(values: np.ndarray) -> Any:
    """Return the largest value of a non-empty array, or NaN."""
    return values.item(values.argmax())


def all_true(flags: np.ndarray) -> bool:
    """Return True if all flags of a non-empty array are true."""
    return bool(smallest(flags))


def all_finite(values: Array) -> bool:
    """Return True if all values of a non-empty array are finite."""
    return bool(smallest(values) > -math.inf and largest(values) < math.inf)


def solved(A: Array, b: Array) -> Array:
    """Solve A x = b for a regular matrix A (n, n)."""
    x: Array = dgesv(A, b)[2]
    return x


def sum_of_squares(values: Array) -> float:
    """Return Σ vᵢ²; not finite for NaN and values above 1e150."""
    return float(np.vdot(values, values))
