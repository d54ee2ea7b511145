"""Places in an array that follow each other."""

from __future__ import annotations

import numpy as np


def as_slice(index: np.ndarray) -> np.ndarray | slice:
    """Give the same places as a slice where they follow each other: faster to read, and a view instead of a copy.

    Args:
        index: places, (k,).
    """
    if len(index) and (np.diff(index) == 1).all():
        return slice(int(index[0]), int(index[-1]) + 1)
    return index
