"""Playback of a recording on the page."""

import time
from contextlib import closing

import numpy as np
import pytest
from browser import Browser
from waiting import repeated

from wbc_controller.apps.page.playback import Playback, TimeLine, marks_html
from wbc_controller.apps.page.server import Gate, open_server
from wbc_controller.apps.page.snapshot import Robot


@pytest.fixture
def recorded(record, tmp_path):
    """Return the recording of a standing controller and an emergency stop."""
    run = record(tmp_path / "run.mcap")
    run.stand(30)
    run.bench.command("estop")
    run.go(10)
    return run.finish()


@pytest.fixture
def playback(recorded):
    made = Playback(recorded, Robot(recorded.config.settings, recorded.config.urdf))
    made.playing = False
    return made


def test_snapshots_agree_with_the_recording(recorded, playback):
    cycles = [cycle for cycle in recorded.cycles() if cycle.scalar("has_state")]
    for cycle in (cycles[0], cycles[len(cycles) // 2], cycles[-1]):
        playback.seek(1e-9 * (cycle.time - recorded.start))
        snapshot = playback.snapshot()
        np.testing.assert_array_equal(snapshot.q, cycle.values["q"])
        assert snapshot.stamp == cycle.time


def test_events_are_marked(recorded, playback):
    kinds = [(mark.kind, mark.text.partition(":")[0]) for mark in playback.marks]
    assert ("mode", "active") in kinds
    assert ("fault", "ESTOP") in kinds
    fault = next(mark for mark in playback.marks if mark.kind == "fault")
    playback.seek(fault.time - 0.004)
    active = playback.snapshot()
    assert active.mode == "active"
    assert set(active.forces) == set(recorded.config.settings.contacts)
    assert active.references is not None
    assert active.torques is not None
    playback.seek(playback.duration)
    assert playback.snapshot().mode.startswith("fault ESTOP: ")
    assert "emergency stop" in marks_html(playback)


def test_time_advances_only_during_playback(playback):
    playback.snapshot()
    time.sleep(0.02)
    assert playback.snapshot().stamp == playback.snapshot().stamp
    assert playback.time == 0.0
    playback.playing, playback.speed = True, 100.0
    time.sleep(0.05)
    playback.snapshot()
    assert (playback.time, playback.playing) == (playback.duration, False)


@pytest.mark.live
def test_user_sets_the_time_during_playback(playback):
    gate = Gate("127.0.0.1")
    server = open_server("127.0.0.1", 0, gate)
    line = TimeLine(server, playback)
    playback.speed = 1e-3

    def show():
        playback.snapshot()
        line.show()

    with repeated(show), closing(Browser(gate.port)) as page:
        page.until(lambda: any(props.get("label") == "Time [s]" for props in page.controls.values()))
        for wanted in 20 * (0.04, 0.02):
            playback.playing = True
            page.set("Time [s]", wanted)
            page.until(lambda: not playback.playing)
            assert playback.time == pytest.approx(wanted)
    server.stop()
