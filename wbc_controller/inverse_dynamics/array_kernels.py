"""Copies of arrays for kernels.

Sizes are not checked. A slice assignment, ``a[:] = b``, checks them, but compiles for seconds.
"""

from wbc_controller.compilation import part
from wbc_controller.records import Array


@part
def copy(values: Array, out: Array) -> None:
    """Copy a vector, (n,)."""
    for i in range(len(values)):
        out[i] = values[i]


@part
def copy_rows(values: Array, out: Array) -> None:
    """Copy a matrix, (m, n)."""
    for i in range(len(values)):
        for j in range(values.shape[1]):
            out[i, j] = values[i, j]
