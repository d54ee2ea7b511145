"""A recording that is read: formats of other versions, and topics that are added after the run."""

from __future__ import annotations

import numpy as np
import pytest
from rosbags.rosbag2.storage_mcap import McapReader

from wbc_controller.controller.cycle import ControlCycle
from wbc_controller.errors import ConfigurationError
from wbc_controller.middleware.codec import encode, message
from wbc_controller.middleware.odometry import odometry
from wbc_controller.middleware.setpoints import wrench_stamped
from wbc_controller.recording.added_topics import add_topics
from wbc_controller.recording.cycle_layout import FORMAT
from wbc_controller.recording.recording_file import Recording
from wbc_controller.recording.replay.cycle_replay import Replay
from wbc_controller.recording.report.run_from_recording import PHASES, run_of, truth_topics


@pytest.mark.parametrize("other", [3, FORMAT + 1])
def test_a_recording_in_another_format_is_rejected_with_both_formats(record, tmp_path, monkeypatch, other):
    monkeypatch.setattr("wbc_controller.recording.recorder.FORMAT", other)
    run = record(tmp_path / "a.mcap")
    run.stand(5)
    run.recorder.close()
    expected = rf"a\.mcap: its format is {other}; this version reads format {FORMAT}: read it with the version of"
    with pytest.raises(ConfigurationError, match=expected):
        Recording(tmp_path / "a.mcap")


@pytest.fixture
def finished(record, tmp_path):
    run = record(tmp_path / "a.mcap")
    run.stand(60)
    return run.finish(tmp_path / "a.mcap")


def wrench(stamp: int, force: float) -> bytes:
    return encode(wrench_stamped(np.full(6, force), "foot", stamp))


def phase(name: str) -> bytes:
    return encode(message("std_msgs/msg/String", data=name))


def added(recording: Recording) -> dict[tuple[str, str], list[tuple[int, bytes]]]:
    stamps = [cycle.stamp for cycle in recording.cycles()]
    topics = [topic for topic in truth_topics(recording.config.settings) if topic.key == "contact_wrench"]
    wrenches = {
        (topic.name, topic.type): [(stamp, wrench(stamp, float(i))) for i, stamp in enumerate(stamps)]
        for topic in topics
    }
    return {**wrenches, (PHASES, "std_msgs/msg/String"): [(0, phase("start")), (stamps[30], phase("stand"))]}


def test_added_messages_stand_at_their_cycles_and_all_others_stay(finished):
    before = [(topic.name, time, data) for topic, time, data in finished.messages()]
    topics = added(finished)
    add_topics(finished.path, topics)
    recording = Recording(finished.path)
    assert recording.damage == ""
    names = {name for name, _ in topics}
    after = [(topic.name, time, data) for topic, time, data in recording.messages()]
    assert sorted(each for each in after if each[0] not in names) == sorted(before)
    times = [cycle.time for cycle in recording.cycles()]
    (name, *_) = sorted(names - {PHASES})
    assert [time for topic, time, _ in after if topic == name] == pytest.approx(times)
    assert [time for topic, time, _ in after if topic == PHASES] == pytest.approx([times[0], times[30]])
    reader = McapReader(finished.path)
    reader.open()
    assert sum(1 for _ in reader.messages(reader.connections)) == len(after)
    assert all(each.same for each in Replay(recording).run())


def test_the_report_shows_the_truth_and_the_phases(finished):
    add_topics(finished.path, added(finished))
    recording = Recording(finished.path)
    run = run_of(recording, ControlCycle(recording.config, preflight=False))
    assert set(run.true_wrenches) == set(recording.config.settings.contacts)
    first = next(i for i, cycle in enumerate(recording.cycles()) if cycle.number_of("has_command"))
    expected = np.arange(first, first + len(run.time))
    for forces in run.true_wrenches.values():
        np.testing.assert_array_equal(forces, np.tile(expected, (3, 1)).T)
    assert [each.name for each in run.phases] == ["start", "stand"]
    assert run.phases[1].time == pytest.approx(run.time[30 - first], abs=1e-6)


def test_with_an_estimated_base_the_report_shows_the_true_one(finished):
    """The recording is of a base from odometry; with an estimated base, odometry is the truth of a simulation."""
    config = finished.config.replace({"estimation.base_state": "imu"})
    controller = ControlCycle(config, preflight=False)
    (topic,) = [topic for topic in truth_topics(config.settings) if topic.key == "odom"]
    pose = np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0])
    true = [
        (cycle.stamp, encode(odometry(cycle.stamp, "world", controller.model.base_link, pose, np.zeros(6))))
        for cycle in finished.cycles()
    ]
    assumed = run_of(finished, controller)
    add_topics(finished.path, {(topic.name, topic.type): true})
    shown = run_of(Recording(finished.path), controller)
    np.testing.assert_array_equal(shown.q[:, :7], np.tile(pose, (len(shown.q), 1)))
    np.testing.assert_array_equal(shown.q[:, 7:], assumed.q[:, 7:])
    assert (shown.com[:, 2] > 2.0).all()
