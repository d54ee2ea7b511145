"""How late the machine is, as the live trials see it."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from wbc_controller.fuzz.rig import Lateness
from wbc_controller.live.processes import until

SPIN = [sys.executable, "-c", "while True: pass"]


@pytest.mark.live
def test_processes_that_wait_for_a_processor_are_late_though_this_one_is_not():
    lateness = Lateness()
    many = [subprocess.Popen(SPIN) for _ in range(3 * len(os.sched_getaffinity(0)))]
    try:
        for process in many:
            lateness.watch(process.pid)
        lateness.forget()
        # Three share each processor: within the window of 50 ms each of them waits for about 33.
        until(lambda: lateness.worst > 0.015, "lateness")
    finally:
        for process in many:
            process.kill()
            process.wait()
        lateness.end()
