"""Lockstep runs are reproducible bit for bit, here without odometry and with sensor noise."""

import os
import subprocess
import sys

import numpy as np

from wbc_controller.recording.recording_file import Recording

SCRIPT = """
import sys
from pathlib import Path
from wbc_controller.apps.demo import director, run, scenario
director._SETTLING_TIME = 0.6
run.write_run_report = lambda *arguments, **options: None  # not compared
scenario.SCENARIOS["go2"] = scenario.Scenario(
    stand=0.2,
    moves=(scenario.Move("sway", ((0.3, (0.0, 0.02, 0.0)), (0.6, (0.0, 0.0, 0.0))), 0.005),),
    shoves=(scenario.Shove("shove left", (0.0, 5.0, 0.0)),),
    recovery=0.3,
)
run.run_demo("go2", Path(sys.argv[1]), lockstep=True, sensors="good")
"""


def test_two_processes_send_the_same_torques_bit_for_bit(tmp_path):
    folders = [tmp_path / name for name in ("first", "second")]
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", SCRIPT, str(folder)],
            env={**os.environ, "PYTHONHASHSEED": seed},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
        for folder, seed in zip(folders, ("1", "4242"), strict=True)
    ]
    for process in processes:
        output, _ = process.communicate(timeout=300)
        assert process.returncode == 0, output.decode()
        rows = [line.split() for line in output.decode().splitlines() if line.rstrip().endswith(("met", "missed"))]
        missed = [" ".join(row) for row in rows if row[-1] == "missed"]
        assert len(rows) >= 6
        assert missed == []
    first, second = (Recording(folder / "go2.mcap").arrays() for folder in folders)
    assert len(first["tau"]) > 2000
    assert np.abs(first["tau"]).max() > 1.0
    for name in ("stamp", "mode", "tau"):
        assert np.array_equal(first[name], second[name]), name
        assert first[name].tobytes() == second[name].tobytes(), name
