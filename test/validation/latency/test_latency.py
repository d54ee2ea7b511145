"""`wbc bench latency`: refusals, output, and the command with real processes."""

import dataclasses
import json
import sys
import threading
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import wbc
from domains import own_domain
from launching import patient
from refusals import refusal

from wbc_controller.errors import WbcError
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.nodes.processes import Processes
from wbc_controller.settings.service import RealtimeSettings
from wbc_controller.simulation.mock_robot import MockRobot
from wbc_controller.validation.latency import latency
from wbc_controller.validation.latency.latency import Latency, figures, lines, measure_latency
from wbc_controller.validation.latency.meter import RoundTrips

FOUND = Latency(
    controller=RoundTrips(np.array([0.0007] * 98 + [0.003, np.inf]), np.array([0.0] * 98 + [0.004]), 0.002),
    echo=RoundTrips(np.array([0.0002] * 100), np.zeros(99), 0.002),
    active=0.253,
    inactive=0.124,
    waiting=0.012,
    memory=(102_400, 103_424),
    scheduling="fifo 50 on processor 1",
    inactive_states=(),
)


def test_table_and_file_of_a_measurement():
    text = "\n".join(lines(FOUND))
    assert "controller        700     3000     3000" in text
    assert "bare echo         200      200      200" in text
    assert "difference        500     2800     2800" in text
    assert "late: 2.000 % of 100 states (1 without torques) at 500 Hz, echo 0.000 % of 100" in text
    assert "25.3 % of one processor active, 12.4 % inactive; 100.0 MB at the start, 101.0 MB at the end" in text
    assert "; fifo 50 on processor 1" in text
    assert "median 0 us, p99 4000 us, p99.9 4000 us" in text
    assert "waited for a processor for 1.20 % of the time" in text
    assert "not always active" not in text
    found = dataclasses.replace(FOUND, inactive_states=("damping FALLEN: …", "damping FALLEN: …"))
    assert lines(found)[-1] == "inactive states of the controller: damping FALLEN: …"
    kept = json.loads(json.dumps(figures(FOUND)))
    assert kept["difference_us"]["median"] == pytest.approx(500.0)
    assert kept["controller"] == {"states": 100, "late": 2, "without_torques": 1}
    assert kept["rate_hz"] == pytest.approx(500.0)
    assert kept["controller_processor_share"] == {"active": 0.253, "inactive": 0.124}
    assert kept["controller_memory_kb"] == [102_400, 103_424]


def test_thread_of_the_robot_has_low_priority_and_reports_exceptions(monkeypatch):
    behind, ran = [], []
    monkeypatch.setattr(latency, "lower_thread_priority", lambda: behind.append(threading.get_ident()))

    def run(stop):
        ran.append(threading.get_ident())
        stop.wait()
        raise WbcError("the simulation has diverged")

    with pytest.raises(WbcError, match="diverged"), latency._running(SimpleNamespace(run=run)):
        pass
    assert ran == behind != [threading.get_ident()]


@pytest.mark.parametrize(("named", "others"), [([2], [0, 1]), ([], []), ([0, 1, 2], [])])
def test_other_processes_avoid_the_controller_s_processors(robot_of, monkeypatch, named, others):
    done = []
    monkeypatch.setattr(latency, "processors", lambda: {0, 1, 2})
    monkeypatch.setattr(latency, "apply_realtime", done.append)  # for this process and its children
    monkeypatch.setattr(latency._Bench, "_start", lambda self, name: done.append(name))
    settings, asked = robot_of("go2")[0], RealtimeSettings(scheduling="fifo", priority=50, affinity=named)
    settings = settings.model_copy(update={"control": settings.control.model_copy(update={"realtime": asked})})
    latency._Bench(SimpleNamespace(settings=settings), MemoryTransport(MemoryBus()), "dds", 0, mock=False)
    before, *started, after = done
    assert started == ["controller", "guard"]
    assert before == RealtimeSettings(affinity=others)  # without the scheduling class
    assert after == RealtimeSettings(scheduling="fifo", priority=50, affinity=others)


def test_invalid_options_and_an_ended_controller_are_reported(tmp_path, monkeypatch):
    bench = object.__new__(latency._Bench)
    bench._states, bench._processes = [], Processes("go2", tmp_path, 0)
    bench._processes.launch("controller", [sys.executable, "-c", "print('no processor 1000'); exit(2)"]).wait()
    with pytest.raises(WbcError, match="the controller ended with exit status 2:\nno processor 1000"):
        bench._activate()
    for seconds in (0.0, -1.0, float("nan"), float("inf")):
        said = f"seconds = {seconds}; valid: positive and finite"
        assert said in refusal(measure_latency, "go2", tmp_path, seconds=seconds)
    assert "control.rate = 0.0" in wbc("bench", "latency", "go2", "--rate", "0", "--out", tmp_path, status=2).stderr
    monkeypatch.setattr(latency.sys, "platform", "darwin")
    assert "requires /proc (Linux), got darwin" in refusal(measure_latency, "go2", tmp_path)


@pytest.mark.live
@pytest.mark.parametrize(("transport", "driver"), [("dds", []), ("dds", ["--mock"]), ("rclpy", [])])
def test_command_measures_controller_and_echo(forks, tmp_path, monkeypatch, transport, driver):
    monkeypatch.setattr(latency, "_BLOCK", 0.5)  # two blocks, with a stopped controller in between
    monkeypatch.setattr(latency, "_LANDING", 0.5)
    made = []

    class Kept(MockRobot):
        def __init__(self, *words):
            super().__init__(*words)
            made.append(self)

    monkeypatch.setattr(latency, "MockRobot", Kept)
    if transport == "rclpy":
        pytest.importorskip("rclpy", reason="rclpy is not importable")
    words = ["--seconds", "1", "--transport", transport, "--domain", str(own_domain()), "--out", str(tmp_path)]
    result = wbc("bench", "latency", patient("go2", tmp_path), *words, *driver)
    kept = json.loads((tmp_path / "latency.json").read_text())
    for path in ("controller", "echo"):
        states, without = kept[path]["states"], kept[path]["without_torques"]
        assert 20 < states <= 550  # 500 on a punctual machine
        assert without < states
        assert 0.0 < kept[f"{path}_us"]["median"] <= kept[f"{path}_us"]["p99"] <= kept[f"{path}_us"]["p99.9"]
    assert kept["controller_us"]["median"] > kept["echo_us"]["median"]
    share = kept["controller_processor_share"]
    assert 0.0 < share["inactive"] < share["active"] < 4.0
    assert min(kept["controller_memory_kb"]) > 20_000
    assert "on processor" in kept["scheduling"]
    assert f" over {transport}" in result.output
    assert [robot.plant.held for robot in made] == [False] * len(driver)  # released from the hoist


@pytest.mark.parametrize("alive", [True, False])
def test_killed_echo_is_not_stopped(monkeypatch, alive):
    """Setting an event blocks if a waiting process was killed."""
    told = []
    process = SimpleNamespace(start=lambda: None, is_alive=lambda: alive, join=lambda: told.append("joined"))
    event = SimpleNamespace(set=lambda: told.append("stopped"))
    context = SimpleNamespace(Event=lambda: event, Process=lambda **named: process)
    monkeypatch.setattr(latency.multiprocessing, "get_context", lambda kind: context)
    bench = SimpleNamespace(_kind="dds", _domain=92, _echo_topics=(), _size=1, _echo_realtime=None)
    with latency._Bench.run_echo(bench):
        assert told == []
    assert told == ["stopped"] * alive + ["joined"]
