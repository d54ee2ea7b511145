"""Waiting for a condition in another thread or process."""

import time
from collections.abc import Callable

from busy import slowness


def until(
    condition: Callable[[], object],
    what: str = "a condition",
    patience: float = 40.0,
    again: Callable[[], None] = lambda: None,
) -> None:
    """Wait until a condition holds; `again` is done at once and then twice a second.

    Args:
        patience: longest time on a computer without other work, s.
    """
    began, due = time.monotonic(), 0.0
    while not condition():
        now = time.monotonic()
        if now >= due:
            again()
            due = now + 0.5
        assert now - began < patience * slowness(), f"waited {now - began:.0f} s in vain for {what}"
        time.sleep(0.01)
