"""Measure the ratio of NumPy's own calls to `inverse_dynamics.arrays` on the arrays of a cycle."""

import timeit

import numpy as np

from wbc_controller.inverse_dynamics import arrays

SIZE = 30
ROUNDS, CALLS = 15, 20000


def main() -> None:
    """Time each pair in turn, and print the ratio of their best rounds."""
    rng = np.random.default_rng(0)
    values = rng.normal(size=SIZE)
    flags, A = values > -10.0, rng.normal(size=(SIZE, SIZE))
    index = np.arange(6, 6 + SIZE // 2)
    part = arrays.as_slice(index)
    one, other = rng.normal(size=(2, 3))
    pairs = {
        "cross": (lambda: np.cross(one, other), lambda: arrays.cross(one, other)),
        "min, smallest": (lambda: values.min(), lambda: arrays.smallest(values)),
        "all, all_true": (lambda: flags.all(), lambda: arrays.all_true(flags)),
        "isfinite.all, all_finite": (lambda: np.isfinite(values).all(), lambda: arrays.all_finite(values)),
        "linalg.solve, solved": (lambda: np.linalg.solve(A, values), lambda: arrays.solved(A, values)),
        "isfinite.all of a matrix, sum_of_squares": (lambda: np.isfinite(A).all(), lambda: arrays.sum_of_squares(A)),
        "index array, as_slice": (lambda: values[index], lambda: values[part]),
    }
    for name, (theirs, ours) in pairs.items():
        times = [min(timeit.repeat(call, number=CALLS, repeat=ROUNDS)) / CALLS for call in (theirs, ours)]
        print(f"{name}: {1e6 * times[0]:.2f} us, {1e6 * times[1]:.2f} us, ratio {times[0] / times[1]:.1f}")


if __name__ == "__main__":
    main()
