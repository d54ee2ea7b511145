"""What the tables say of measured seconds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from wbc_controller.records import Array


@dataclass(frozen=True)
class Summary:
    """Of the cycles of one contestant, in s, without those that found no solution.

    Attributes:
        median: of all.
        p99: 99 of 100 cycles took at most this.
        p999: 999 of 1000 did.
        mean: of all.
        failures: cycles without a solution.
    """

    median: float
    p99: float
    p999: float
    mean: float
    failures: int

    def __str__(self) -> str:
        """Median, p99 and p99.9 in µs."""
        return "".join(f"{1e6 * value:8.0f}" for value in (self.median, self.p99, self.p999))


def summary(blocks: Sequence[Array]) -> Summary:
    """Summarize the blocks of one contestant, each (n,)."""
    seconds = np.concatenate([np.asarray(block) for block in blocks])
    solved = seconds[np.isfinite(seconds)]
    failures = len(seconds) - len(solved)
    if not len(solved):
        return Summary(np.nan, np.nan, np.nan, np.nan, failures)
    # A quantile that is not between two cycles: the slower one of them, as a mean of them happened to nobody.
    median, p99, p999 = np.quantile(solved, (0.5, 0.99, 0.999), method="higher")
    return Summary(float(median), float(p99), float(p999), float(solved.mean()), failures)


def share(ours: Sequence[Array], theirs: Sequence[Array]) -> tuple[float, float, float]:
    """Our median as a share of theirs: over all blocks, and the smallest and largest of a pair of neighbouring blocks.

    Args:
        ours: seconds of each block, each (n,).
        theirs: likewise, of the same blocks.
    """
    pairs = [summary([mine]).median / summary([other]).median for mine, other in zip(ours, theirs, strict=True)]
    return summary(ours).median / summary(theirs).median, float(np.nanmin(pairs)), float(np.nanmax(pairs))


def exponent(sizes: Array, seconds: Array) -> tuple[float, float]:
    """Exponent b and factor a of the power law a nᵇ that fits best: least squares of the logarithms.

    Args:
        sizes: n, above 0, (k,).
        seconds: (k,).
    """
    b, log_a = np.polyfit(np.log(sizes), np.log(seconds), 1)
    return float(b), float(np.exp(log_a))
