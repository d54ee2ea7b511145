"""Measure the call of a compiled function, with arrays as arguments and with a struct of the same arrays.

The functions are almost empty. Warm: best of many rounds. Cold: median of single calls, each after writing other memory
and parsing a text, as in `compare.py`.
"""

import sys
import time
import timeit
from collections.abc import Callable
from typing import Any

import numpy as np
from call_kernels import Six, from_arguments, from_struct, from_struct_and_array
from serving import CacheEviction

CALLS, ROUNDS, COLD = 20000, 15, 400
#: Bytes written before a cold call.
EVICTION_BYTES = 64 << 20


def measure(cold: int, rounds: int) -> dict[str, tuple[float, float]]:
    """Return the time of a call, warm and cold, s, by kind of arguments, of `cold` calls and `rounds` of warm calls."""
    arrays = {name: np.full(30, float(i)) for i, name in enumerate("abcde")}
    out = np.zeros(30)
    six = Six(**arrays, factor=2.0, out=out)
    arguments = *arrays.values(), 2.0, out
    ways: dict[str, Callable[[], Any]] = {
        "arguments": lambda: from_arguments(*arguments),
        "struct": lambda: from_struct(six),
        "struct and array": lambda: from_struct_and_array(six, arrays["a"]),
    }
    expected = {name: call() for name, call in ways.items()}
    if set(expected.values()) != {20.0}:
        raise RuntimeError(f"the results differ: {expected}")
    warm = {name: min(timeit.repeat(call, number=CALLS, repeat=rounds)) / CALLS for name, call in ways.items()}
    eviction, seconds = CacheEviction(), {name: np.zeros(cold) for name in ways}
    for i in range(cold):
        for name, call in ways.items():
            eviction.work(EVICTION_BYTES)
            started = time.perf_counter()
            call()
            seconds[name][i] = time.perf_counter() - started
    return {name: (warm[name], float(np.median(seconds[name]))) for name in ways}


def main() -> None:
    """Print the times of all kinds of arguments."""
    if len(sys.argv) > 1:
        raise SystemExit(f"unknown argument {sys.argv[1]!r}; this script has no arguments")
    print(f"{'us':24}{'warm':>8}{'cold':>8}")
    for name, (warm, cold) in measure(COLD, ROUNDS).items():
        print(f"{name:24}{1e6 * warm:8.2f}{1e6 * cold:8.1f}")


if __name__ == "__main__":
    main()
