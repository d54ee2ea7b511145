"""Workers of campaigns and accuracy trials."""

import os
import subprocess
import sys
from types import SimpleNamespace

from waiting import has_ended, until

from wbc_controller.nodes.processes import end_with_parent
from wbc_controller.validation.accuracy.accuracy_commands import run_parallel

SCRIPT = """
import os, sys, time
from pathlib import Path
from wbc_controller.validation.campaign.run import _parallel

def work(folder, number):
    Path(folder, str(os.getpid())).touch()
    time.sleep(60.0)

with _parallel(2, "loky", None, work) as run:
    list(run([(sys.argv[1], number) for number in range(2)]))
"""


def test_workers_end_with_their_killed_parent(tmp_path):
    parent = subprocess.Popen([sys.executable, "-c", SCRIPT, str(tmp_path)])
    until(lambda: len(os.listdir(tmp_path)) == 2, "two workers", patience=60.0)
    parent.kill()
    parent.wait()
    workers = [int(name) for name in os.listdir(tmp_path)]
    until(lambda: all(map(has_ended, workers)), "the workers to end", patience=5.0)


def test_workers_of_accuracy_trials_end_with_their_parent_too(monkeypatch):
    """Joblib passes the initializer to the same workers."""
    given = []
    joblib = SimpleNamespace(Parallel=lambda *words, **options: given.append(options) or list, delayed=lambda of: of)
    monkeypatch.setitem(sys.modules, "joblib", joblib)
    assert run_parallel(abs, [(-1,)], 2) == [1]
    assert given == [{"initializer": end_with_parent}]
