"""Waiting for a condition in another thread or process."""

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from busy import slowness


def until(
    condition: Callable[[], object],
    what: str | Callable[[], str] = "a condition",
    patience: float = 40.0,
    again: Callable[[], None] = lambda: None,
    advance: Callable[[], object] = lambda: time.sleep(0.01),
    period: float = 0.5,
) -> None:
    """Wait until a condition holds; `again` is done at once and then every `period`, s, `advance` before each check.

    Args:
        what: condition for the error message, or a function that describes it then.
        patience: longest time on a computer without other work, s.
    """
    began, due = time.monotonic(), 0.0
    while not condition():
        now = time.monotonic()
        if now >= due:
            again()
            due = now + period
        if now - began >= patience * slowness():
            raise AssertionError(f"waited {now - began:.0f} s in vain for {what() if callable(what) else what}")
        advance()


def has_ended(process: int) -> bool:
    """Return True for a process that has ended, also if nobody has waited for it."""
    stat = Path(f"/proc/{process}/stat")
    return not stat.exists() or stat.read_text(encoding="ascii").rpartition(")")[2].split()[0] == "Z"


@contextlib.contextmanager
def repeated(action: Callable[[], object], period: float = 1e-3) -> Iterator[None]:
    """Repeat an action in a thread."""
    ended = threading.Event()

    def repeat() -> None:
        while not ended.wait(period):
            action()

    thread = threading.Thread(target=repeat, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@contextlib.contextmanager
def running(function: Callable[..., object], *arguments: Any, stop: Callable[[], object]) -> Iterator[threading.Thread]:
    """Run a function in a thread; at the end of the block it must return after `stop`."""
    thread = threading.Thread(target=function, args=arguments, daemon=True)
    thread.start()
    try:
        yield thread
    finally:
        stop()
        thread.join(10.0 * slowness())
    assert not thread.is_alive()
