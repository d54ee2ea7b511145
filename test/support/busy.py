"""Busy computers: the time that a step may take, and the repetition of live tests that failed there."""

import contextlib
import os
import subprocess
import sys
import warnings
from collections.abc import Iterator

import pytest
from _pytest.runner import runtestprotocol

#: Slowness from which a failure may be the computer's, and how often a live test is then run at most.
BUSY, ATTEMPTS = 2.0, 3


def slowness() -> float:
    """Processes that are ready to run, per processor, in the last minute; at least 1."""
    return max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))


def patience(seconds: float) -> float:
    """The wall time that a step may take now, s, from that on a computer without other work."""
    return seconds * slowness()


@contextlib.contextmanager
def busy_processes(count: int) -> Iterator[list[subprocess.Popen[bytes]]]:
    """Keep processors busy with some processes."""
    processes = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield processes
    finally:
        for process in processes:
            process.kill()
            process.wait()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Run a live test; one that fails on a busy computer is repeated with new fixtures. A fault fails every time."""
    if item.get_closest_marker("live") is None:
        return None
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for attempt in range(1, ATTEMPTS + 1):
        reports = runtestprotocol(item, nextitem=nextitem, log=False)
        if not any(report.failed for report in reports) or attempt == ATTEMPTS or slowness() < BUSY:
            break
        text = "\n".join(report.longreprtext for report in reports if report.failed)
        reason = next((line[1:].strip() for line in text.splitlines() if line.startswith("E ")), text)
        load = os.getloadavg()[0]
        warnings.warn(f"{item.nodeid} failed at a load average of {load:.1f}, and is repeated: {reason}", stacklevel=1)
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True
