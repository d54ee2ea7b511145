"""Lateness of the machine, as measured in live trials."""

import os
from pathlib import Path

import pytest
from busy import busy_processes
from waiting import until

from wbc_controller.validation.fuzz.robot_processes import Lateness


@pytest.fixture
def lateness():
    made = Lateness()
    yield made
    made.end()


@pytest.mark.live
def test_waiting_processes_are_late(lateness):
    with busy_processes(3 * len(os.sched_getaffinity(0))) as many:
        for process in many:
            lateness.processes.add(process.pid)
        lateness.worst = 0.0
        # Three processes share each processor: each waits for about 33 ms of the 50 ms window.
        until(lambda: lateness.worst > 0.015, "lateness")


def test_process_may_end_during_the_measurement(lateness, monkeypatch):
    ended, looks, glob = Path("/proc/0/task"), [], Path.glob

    def look(path, pattern):
        looks.append(path)
        if path == ended:
            raise FileNotFoundError(2, "No such file or directory", str(path))
        return glob(path, pattern)

    monkeypatch.setattr(Path, "glob", look)
    lateness.processes.add(0)
    until(lambda: ended in looks, "the check of the ended process")
    after = len(looks) + 2  # more than the rest of this round
    until(lambda: len(looks) > after, "the next check")
    assert looks.count(ended) == 1
