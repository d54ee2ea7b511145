"""Shutdown on SIGINT, SIGTERM and SIGHUP."""

import contextlib
import os
import signal
import threading
from collections.abc import Iterator

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def exit_by_signals(error: type[BaseException] = SystemExit) -> None:
    """Raise an exception on SIGTERM and SIGHUP, to stop child processes."""

    def leave(number: int, frame: object) -> None:
        raise error(128 + number)

    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, leave)


@contextlib.contextmanager
def set_by_signals(stop: threading.Event) -> Iterator[None]:
    """Set an event on SIGINT, SIGTERM, and SIGHUP without ``nohup``; a signal handler would deadlock with `wait`."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)

    def watch() -> None:
        while numbers := os.read(reading, 1):  # empty after the other end was closed
            if numbers[0] in ENDING:
                stop.set()

    watcher = threading.Thread(target=watch, name="signals", daemon=True)
    watcher.start()
    nohup = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    ending = [number for number in ENDING if not (nohup and number == signal.SIGHUP)]
    previous = {number: signal.signal(number, lambda number, frame: None) for number in ending}
    previous_fd = signal.set_wakeup_fd(writing)
    try:
        yield
    finally:
        signal.set_wakeup_fd(previous_fd)
        for number, handler in previous.items():
            signal.signal(number, handler)
        os.close(writing)
        watcher.join()
        os.close(reading)
