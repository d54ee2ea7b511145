"""Prints what it takes to call a compiled function: by Numba's dispatcher, and as the kernels are called.

The function takes six arrays and a number, and does next to nothing with them. Warm is the best of many rounds; cold is
the median of single calls, before each of which other memory is written and a text parsed, as in `compare.py`.
"""

from __future__ import annotations

import sys
import time
import timeit

import numba
import numpy as np
from numba import types
from serving import Elsewhere
from wbc_controller.compiled import NUMBER, VECTOR, VECTOR_OUT, compile_all, compiled

CALLS, ROUNDS, COLD = 20000, 15, 400
#: Bytes that are written before a cold call.
ELSEWHERE = 64 << 20


@compiled(*5 * (VECTOR,), NUMBER, VECTOR_OUT)
def touch(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray, e: np.ndarray, factor: float, out: np.ndarray
) -> float:
    """The sum of the first numbers times a factor."""
    out[0] = factor * (a[0] + b[0] + c[0] + d[0] + e[0])
    return float(out[0])


_READ, _WRITTEN = types.Array(types.float64, 1, "C", readonly=True), types.Array(types.float64, 1, "C")
_SIGNATURE = types.float64(*5 * (_READ,), types.float64, _WRITTEN)
dispatched = numba.njit(_SIGNATURE, error_model="numpy")(touch.py_func)
compile_all()  # from here on `touch` is the machine code


def measure(cold: int, rounds: int) -> dict[str, tuple[float, float]]:
    """Seconds of a call, warm and cold, by the way it goes.

    Args:
        cold: number of cold calls, in turn.
        rounds: number of rounds of warm ones.
    """
    arguments = [np.full(30, float(i)) for i in range(5)] + [2.0, np.zeros(30)]
    ways = {"Numba's dispatcher": dispatched, "as kernels are called": touch}
    expected = {name: call(*arguments) for name, call in ways.items()}
    if set(expected.values()) != {20.0}:
        raise RuntimeError(f"the ways differ: {expected}")
    warm = {
        name: min(timeit.repeat(lambda call=call: call(*arguments), number=CALLS, repeat=rounds)) / CALLS
        for name, call in ways.items()
    }
    elsewhere, seconds = Elsewhere(), {name: np.zeros(cold) for name in ways}
    for i in range(cold):
        for name, call in ways.items():
            elsewhere.work(ELSEWHERE)
            started = time.perf_counter()
            call(*arguments)
            seconds[name][i] = time.perf_counter() - started
    return {name: (warm[name], float(np.median(seconds[name]))) for name in ways}


def main() -> None:
    """Print both ways."""
    if len(sys.argv) > 1:
        raise SystemExit(f"{sys.argv[1]!r}: no arguments are taken")
    print(f"{'us':24}{'warm':>8}{'cold':>8}")
    for name, (warm, cold) in measure(COLD, ROUNDS).items():
        print(f"{name:24}{1e6 * warm:8.2f}{1e6 * cold:8.1f}")


if __name__ == "__main__":
    main()
