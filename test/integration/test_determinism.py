"""Lockstep runs are reproducible bit for bit, here without odometry and with sensor noise; a demo meets its targets."""

import os
import subprocess
import sys
from pathlib import Path
from unittest.mock import patch

import numpy as np

from wbc_controller.apps.demo import run, scenario
from wbc_controller.recording.recording_file import Recording
from wbc_controller.validation.accuracy import estimation_trial
from wbc_controller.validation.accuracy.estimation_trial import EstimationTrial

SCRIPT = """
import sys
import numpy
sys.path.append(sys.argv[1])
from test_determinism import swayed_and_shoved
numpy.savez(sys.argv[2], **swayed_and_shoved())
"""


def swayed_and_shoved():
    """Return stamps, modes and torques of Go2, which stands, sways and is pushed."""
    changes = {"estimation.base_state": "imu", "mock.sensors": "good", "safety.activation_ramp": 0.1,
               "estimation.settling": 0.1}  # fmt: skip
    trial, commands = EstimationTrial("go2", changes), []
    trial.loop.observers += (lambda report: commands.append((report.mode.value, report.command)),)
    with patch.object(estimation_trial, "_REST_TIME", 0.2):
        trial.stand()
    trial.follow([0.2, 0.4], [trial.origin + np.array([0.0, 0.02, 0.0]), trial.origin])
    trial.run(0.3)
    trial.mock.plant.push(trial.model.base_link, [0.0, 50.0, 0.0, 0.0, 0.0, 0.0], 0.1)
    trial.run(0.3)
    sent = [(command.stamp, mode, command.tau) for mode, command in commands if command is not None]
    columns = zip(*sent, strict=True)
    return {name: np.array(values) for name, values in zip(("stamp", "mode", "tau"), columns, strict=True)}


def test_two_processes_send_the_same_torques_bit_for_bit(tmp_path):
    words = [sys.executable, "-c", SCRIPT, str(Path(__file__).parent), str(tmp_path / "other.npz")]
    other = {**os.environ, "PYTHONHASHSEED": "4242"}
    process = subprocess.Popen(words, env=other, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    first = swayed_and_shoved()
    output, _ = process.communicate(timeout=300)
    assert process.returncode == 0, output.decode()
    assert len(first["tau"]) > 500
    assert np.abs(first["tau"]).max() > 1.0
    with np.load(tmp_path / "other.npz") as second:
        for name in ("stamp", "mode", "tau"):
            assert first[name].tobytes() == second[name].tobytes(), name


def test_demo_of_a_quadruped_that_sways_and_is_shoved(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("wbc_controller.apps.demo.director._SETTLING_TIME", 0.6)
    monkeypatch.setattr(run, "write_run_report", lambda *arguments, **options: None)
    move = scenario.Move("sway", ((0.3, (0.0, 0.02, 0.0)), (0.6, (0.0, 0.0, 0.0))), 0.005)
    shove = scenario.Shove("shove left", (0.0, 5.0, 0.0))
    short = scenario.Scenario(stand=0.2, moves=(move,), shoves=(shove,), recovery=0.3)
    monkeypatch.setitem(scenario.SCENARIOS, "go2", short)
    run.run_demo("go2", tmp_path, lockstep=True, sensors="good")
    rows = [line.split() for line in capsys.readouterr().out.splitlines() if line.rstrip().endswith(("met", "missed"))]
    assert len(rows) >= 6
    assert [" ".join(row) for row in rows if row[-1] == "missed"] == []
    assert len(Recording(tmp_path / "go2.mcap").arrays()["tau"]) > 2000
