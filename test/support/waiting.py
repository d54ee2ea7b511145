"""Waiting for a condition in another thread or process."""

from __future__ import annotations

import time
from collections.abc import Callable


def until(
    condition: Callable[[], object],
    what: str = "a condition",
    patience: float = 40.0,
    again: Callable[[], None] = lambda: None,
) -> None:
    """Wait until a condition holds, at most `patience`, s; `again` is done at once and then twice a second."""
    deadline, due = time.monotonic() + patience, 0.0
    while not condition():
        if time.monotonic() >= due:
            again()
            due = time.monotonic() + 0.5
        assert time.monotonic() < deadline, f"waited {patience} s in vain for {what}"
        time.sleep(0.01)
