"""Workers of campaigns and accuracy trials."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from busy import patience

from wbc_controller.nodes.processes import until

SCRIPT = """
import os, sys, time
from pathlib import Path
from wbc_controller.validation.accuracy.parallel import run_parallel
from wbc_controller.validation.campaign.run import _parallel

def work(folder, number):
    Path(folder, str(os.getpid())).touch()
    time.sleep(60.0)

calls = [(sys.argv[1], number) for number in range(2)]
"""
STARTS = {
    "accuracy": "run_parallel(work, calls, 2)",
    "campaign": "with _parallel(2, 'loky', None, work) as run: list(run(calls))",
}


def runs(process: int) -> bool:
    stat = Path(f"/proc/{process}/stat")
    return stat.exists() and stat.read_text().rpartition(")")[2].split()[0] != "Z"


@pytest.mark.parametrize("kind", STARTS)
def test_workers_end_with_their_killed_parent(tmp_path, kind):
    parent = subprocess.Popen([sys.executable, "-c", SCRIPT + STARTS[kind], str(tmp_path)])
    until(lambda: len(os.listdir(tmp_path)) == 2, "two workers", patience=patience(60.0))
    parent.kill()
    parent.wait()
    workers = [int(name) for name in os.listdir(tmp_path)]
    until(lambda: not any(map(runs, workers)), "the workers to end", patience=patience(5.0))
