"""Almost empty compiled functions for `calls.py`."""

from wbc_controller.compilation import OutVector, Struct, Vector, compiled


class Six(Struct):
    """Five input arrays, a number, and an output array."""

    a: Vector
    b: Vector
    c: Vector
    d: Vector
    e: Vector
    factor: float
    out: OutVector


@compiled
def from_arguments(a: Vector, b: Vector, c: Vector, d: Vector, e: Vector, factor: float, out: OutVector) -> float:
    """Return the sum of the first elements times a factor."""
    out[0] = factor * (a[0] + b[0] + c[0] + d[0] + e[0])
    return out[0]


@compiled
def from_struct(six: Six) -> float:
    """Return the sum of the first elements times a factor."""
    six.out[0] = six.factor * (six.a[0] + six.b[0] + six.c[0] + six.d[0] + six.e[0])
    return six.out[0]


@compiled
def from_struct_and_array(six: Six, a: Vector) -> float:
    """Return the sum of the first elements times a factor; one array is an argument."""
    six.out[0] = six.factor * (a[0] + six.b[0] + six.c[0] + six.d[0] + six.e[0])
    return six.out[0]
