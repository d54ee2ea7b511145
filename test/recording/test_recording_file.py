"""Reading of recordings: formats of other versions, and topics added after the run."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded_run import by_rosbags, copied, make_run
from refusals import refusal

import wbc_controller
from wbc_controller.controller.cycle import ControlCycle
from wbc_controller.errors import ConfigurationError
from wbc_controller.middleware.codec import decode, encode, message, odometry, wrench_stamped
from wbc_controller.recording.cycle_layout import FORMAT, HEAD
from wbc_controller.recording.mcap_file import McapMessages, write_messages
from wbc_controller.recording.recording_file import Recording, add_topics
from wbc_controller.recording.replay.cycle_replay import Replay
from wbc_controller.recording.report.run_data import PHASES, make_run_data, truth_topics
from wbc_controller.validation.fuzz.hostile_recordings import read_recording

STRING = "std_msgs/msg/String"


def write(path, file, messages):
    """Write changed messages of a file."""
    write_messages(path, file.topics.values(), ((topic.number, time, payload) for topic, time, payload in messages))


@pytest.mark.parametrize("other", [3, FORMAT + 1])
def test_a_recording_in_another_format_is_rejected_with_both_formats(record, tmp_path, monkeypatch, other):
    monkeypatch.setattr("wbc_controller.recording.cycle_layout.FORMAT", other)
    run = record(tmp_path / "a.mcap")
    run.stand(5)
    run.recorder.close()
    said = refusal(Recording, run.file)
    assert f"a.mcap: format {other}; this version reads format {FORMAT}: use the version of" in said


@pytest.fixture(scope="module")
def original(bench, tmp_path_factory):
    folder = tmp_path_factory.mktemp("standing")
    run = make_run(bench, folder, folder / "a.mcap")
    run.stand(60)
    return run.finish().path


@pytest.fixture
def finished(original, tmp_path):
    return copied(original, tmp_path)


def test_a_recording_contains_the_version(finished):
    assert finished.about["software"]["wbc_controller"] == wbc_controller.__version__


def modified(path: Path, topic: str, change: Callable[[dict[str, Any]], None]) -> Path:
    """Return the recording with a changed first message of a topic and valid checksums."""
    file = McapMessages(path)
    messages, done = [], False
    for place, time, payload in file:
        if place.name.endswith(f"/recording/{topic}") and not done:
            content, done = json.loads(decode(payload, place.type).data), True
            change(content)
            payload = encode(message(place.type, data=json.dumps(content, separators=(",", ":"))))
        messages.append((place, time, payload))
    other = path.with_name("modified.mcap")
    write(other, file, messages)
    return other


@pytest.mark.parametrize(
    ("topic", "change", "reason"),
    [
        ("start", lambda start: start.pop("format"), "its start has no 'format'"),
        ("start", lambda start: start.pop("node"), "its start has no 'node'"),
        ("start", lambda start: start.update(config=1), "its start: 'config' is 1, not str"),
        ("start", lambda start: start.update(config="a: 1"), "missing key 'wbc_controller'"),
        ("start", lambda start: start.update(config="[" * 5000), "not valid YAML"),
        ("start", lambda start: start.update(software=[]), r"'software' is \[\], not .*Mapping"),
        ("start", lambda start: start["layout"].pop(0), "the layout must begin with number, now"),
        ("start", lambda start: start["layout"].pop(), "no numbers of references/contact/"),
        ("start", lambda start: start["layout"][20].pop(), "invalid slot"),
        ("start", lambda start: start["layout"][40].__setitem__(2, -1), "invalid slot"),
        ("events", lambda event: event.pop("cycle"), "an event has no 'cycle'"),
        ("events", lambda event: event.update(fault="x"), "an event: 'fault' is 'x', not"),
        ("events", lambda event: event.update(requests={}), r"an event: 'requests' is {}, not list\[str\]"),
        ("events", lambda event: event.update(changes=[[{"$record": "Fault", "code": 1, "sentence": "",
                                                         "infeasibility": None}]]), "Fault: 'code' is 1, not str"),
        ("memory", lambda memory: memory.update(cycle="x"), "a memory must begin with"),
        ("memory", lambda memory: memory["memory"].pop("board"), "the memory before cycle 0: KeyError: 'board'"),
        ("memory", lambda memory: memory["memory"]["board"].update(_tuning=0), "_tuning = 0: expected TuningRamp"),
        ("memory", lambda memory: memory["memory"]["board"]["_weight_ramps"].update(com=1),
         r"_weight_ramps\['com'\] = 1: expected SoftRamp"),
        ("memory", lambda row: row["memory"]["supervisor"]["torques_sent"].update(shape=[1]), "cannot reshape array"),
        ("memory", lambda row: row["memory"]["supervisor"]["torques_sent"].update(type="O"), "array has the type"),
        ("memory", lambda memory: memory["memory"]["board"]["_trajectories"].update(com={"$trajectory": []}),
         "trajectory has no points"),
    ],
)  # fmt: skip
def test_modified_json_with_a_valid_checksum_is_refused_with_the_value(finished, topic, change, reason):
    path = modified(finished.path, topic, change)
    with pytest.raises(ConfigurationError, match=reason) as caught:
        read_recording(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(("name", "value"), [("mode", 99.0), ("mode", np.nan), ("number", np.inf), ("number", -1.0)])
def test_a_cycle_with_numbers_out_of_their_ranges_is_refused(finished, name, value):
    file = McapMessages(finished.path)
    messages = list(file)
    at = next(i for i, (topic, _, _) in enumerate(messages) if topic.name.endswith("/recording/cycle"))
    topic, time, payload = messages[at]
    place = len(payload) - 8 * sum(slot.size for slot in finished.slots if slot.group == "cycle") + 8 * HEAD.index(name)
    messages[at] = topic, time, payload[:place] + np.float64(value).tobytes() + payload[place + 8 :]
    path = finished.path.with_name("modified.mcap")
    write(path, file, messages)
    with pytest.raises(ConfigurationError, match=rf"modified\.mcap: a cycle has {name} = .*; valid: 0 to"):
        Recording(path)


def added(recording: Recording) -> dict[tuple[str, str], list[tuple[int, bytes]]]:
    stamps = [cycle.stamp for cycle in recording.cycles()]
    topics = [topic for topic in truth_topics(recording.config.settings) if topic.key == "contact_wrench"]
    wrenches = [(at, encode(wrench_stamped(np.full(6, float(i)), "foot", at))) for i, at in enumerate(stamps)]
    phases = [(at, encode(message(STRING, data=name))) for at, name in ((0, "start"), (stamps[30], "stand"))]
    return {(topic.name, topic.type): wrenches for topic in topics} | {(PHASES, STRING): phases}


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
    assert len(by_rosbags(finished.path)) == len(after)
    assert all(each.is_identical for each in Replay(recording).run())


def test_the_report_shows_the_truth_and_the_phases(finished):
    add_topics(finished.path, added(finished))
    recording = Recording(finished.path)
    run = make_run_data(recording, ControlCycle(recording.config, preflight=False))
    assert set(run.true_wrenches) == set(recording.config.settings.contacts)
    first = next(i for i, cycle in enumerate(recording.cycles()) if cycle.scalar("has_command"))
    expected = np.arange(first, first + len(run.time))
    for forces in run.true_wrenches.values():
        np.testing.assert_array_equal(forces, np.tile(expected, (3, 1)).T)
    assert [name for _, name in run.phases] == ["start", "stand"]
    assert run.phases[1][0] == pytest.approx(run.time[30 - first], abs=1e-6)


def test_with_an_estimated_base_the_report_shows_the_true_one(finished):
    """The recording has odometry; with an estimated base, odometry is the truth of a simulation."""
    config = finished.config.replace({"estimation.base_state": "imu"})
    controller = ControlCycle(config, preflight=False)
    (topic,) = [topic for topic in truth_topics(config.settings) if topic.key == "odom"]
    pose = np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0])
    stamps, link = [cycle.stamp for cycle in finished.cycles()], controller.model.base_link
    true = [(stamp, encode(odometry(stamp, "world", link, pose, np.zeros(6)))) for stamp in stamps]
    assumed = make_run_data(finished, controller)
    add_topics(finished.path, {(topic.name, topic.type): true})
    shown = make_run_data(Recording(finished.path), controller)
    np.testing.assert_array_equal(shown.q[:, :7], np.tile(pose, (len(shown.q), 1)))
    np.testing.assert_array_equal(shown.q[:, 7:], assumed.q[:, 7:])
    assert (shown.com[:, 2] > 2.0).all()
