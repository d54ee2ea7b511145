"""Statistics of measured times."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from wbc_controller.records import Array


@dataclass(frozen=True)
class Summary:
    """Statistics of a contestant's cycles, s, without cycles that have no solution."""

    median: float
    p99: float  # 99 % quantile
    p999: float  # 99.9 % quantile
    mean: float
    failures: int  # cycles without a solution

    def __str__(self) -> str:
        """Return median, p99 and p99.9 in µs."""
        return "".join(f"{1e6 * value:8.0f}" for value in (self.median, self.p99, self.p999))


def summary(blocks: Sequence[Array]) -> Summary:
    """Summarize the blocks of one contestant, each (n,)."""
    seconds = np.concatenate([np.asarray(block) for block in blocks])
    solved = seconds[np.isfinite(seconds)]
    failures = len(seconds) - len(solved)
    if not len(solved):
        return Summary(np.nan, np.nan, np.nan, np.nan, failures)
    # Quantiles between two cycles use the slower one.
    median, p99, p999 = np.quantile(solved, (0.5, 0.99, 0.999), method="higher")
    return Summary(float(median), float(p99), float(p999), float(solved.mean()), failures)


def share(ours: Sequence[Array], theirs: Sequence[Array]) -> tuple[float, float, float]:
    """Return our median as a share of theirs, over all blocks, each (n,) in s, and its range over adjacent blocks."""
    pairs = [summary([mine]).median / summary([other]).median for mine, other in zip(ours, theirs, strict=True)]
    return summary(ours).median / summary(theirs).median, float(np.nanmin(pairs)), float(np.nanmax(pairs))


def exponent(sizes: Array, seconds: Array) -> tuple[float, float]:
    """Return exponent b and factor a of the power law a nᵇ, by least squares of the logarithms.

    Sizes n, above 0, and times in s are (k,).
    """
    b, log_a = np.polyfit(np.log(sizes), np.log(seconds), 1)
    return float(b), float(np.exp(log_a))


def timed(
    call: Callable[..., Any], add: Callable[[float, Any], None], clock: Callable[[], float] = time.perf_counter
) -> Callable[..., Any]:
    """Return a function that passes the time of each call, s, and its result to `add`."""

    def run(*arguments: Any, **options: Any) -> Any:
        begin = clock()
        result = call(*arguments, **options)
        add(clock() - begin, result)
        return result

    return run
