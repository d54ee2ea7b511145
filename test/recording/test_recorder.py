"""The flight recorder: contents, behaviour without a disk, and the file after a kill."""

import os
import signal
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from recorded_run import by_rosbags
from waiting import has_ended, until

from wbc_controller.middleware.codec import encode
from wbc_controller.middleware.topics import CONTROLLER_TOPICS, endpoints
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.recording.recorder import Recorder, RecordingTransport, recording
from wbc_controller.recording.recording_file import Recording
from wbc_controller.recording.replay.recording_summary import summarize
from wbc_controller.records import ChangeSettings

SCRIPT = Path(__file__).parent.parent / "support" / "killed_recording.py"


def test_a_recording_contains_inputs_commands_and_requests(record, tmp_path, make):
    run = record(tmp_path / "a.mcap")
    bench = run.bench
    run.stand(30)
    bench.send("update", make.string("{tasks: {com: {weight: 3.5}}}"))
    bench.send("command", make.string("nonsense"))
    run.go(20)
    found = run.finish()
    assert (found.first, found.last, found.count, found.damage) == (0, 52, 53, "")
    table = found.arrays()
    np.testing.assert_array_equal(table["tau"], bench.efforts())
    assert table["stamp"].tolist() == [each.stamp for each in bench.reports if each.command is not None]
    assert set(table["mode"]) == {"active"}
    for stage in ("read", "compute", "supervise", "write", "total"):
        assert np.isfinite(table[f"seconds/{stage}"]).all()
    counts = {topic.name: found.counts.get(number, 0) for number, topic in found.topics.items()}
    assert counts["/joint_states"] == counts["/odom"] == 53
    assert counts["/effort_controller/commands"] == len(table["tau"])
    (asked,) = [event for event in found.events.values() if "activate" in event.get("requests", ())]
    assert asked["cycle"] == 3
    (changed,) = [event for event in found.events.values() if "changes" in event]
    changes = [change for each in changed["changes"] for change in each]
    assert any(isinstance(change, ChangeSettings) or change.weight == 3.5 for change in changes)
    (refused,) = [event for event in found.events.values() if "refused" in event]
    assert "command 'nonsense' is unknown" in refused["refused"][0]
    weights = [float(cycle.references["weight/com"][0]) for cycle in found.cycles() if cycle.references]
    assert weights[0] == weights[20] > weights[-2] > weights[-1] > 3.5  # on its ramp
    stored = [data for topic, _, data in found.messages() if topic.name == "/effort_controller/commands"]
    assert stored == bench._payloads["effort", ""]


def test_references_of_a_lost_cycle_do_not_change_the_cycle_before(record, tmp_path, make):
    run = record(tmp_path / "a.mcap")
    run.stand(10)
    run.bench.send("update", make.string("{tasks: {com: {weight: 3.5}}}"))
    run.go(10)
    found = run.finish()
    cycles = list(found.cycles())
    changed = next(i for i in range(5, len(cycles)) if cycles[i].references["number"] == cycles[i].number)
    number, messages = 0, []
    for topic, stamp, payload in found.messages():
        kind = topic.name.rpartition("/")[2]
        number += kind == "cycle"
        if number != changed + 1 or kind == "references" or not topic.name.startswith("/wbc_controller/recording"):
            messages.append((topic, stamp, payload))
    rows = list(found._rows(messages))
    assert len(rows) == len(cycles) - 1
    assert rows[changed - 1][2][0] == cycles[changed - 1].references["number"] < cycles[changed].number
    assert rows[changed][2][0] >= cycles[changed].number


@pytest.mark.parametrize("late", [False, True])
def test_outgoing_messages_precede_their_cycle_with_its_time(record, tmp_path, late):
    run = record(tmp_path / "a.mcap")
    scribe = threading.Event()
    if late:  # JSON frames of early cycles are written last
        run.recorder._jobs.put(lambda: b"" * scribe.wait())
    run.stand(30)
    run.bench.loop._shut_down()  # the last torques belong to no cycle
    scribe.set()
    waiting, cycles = [], []
    for topic, at, _ in run.finish().messages():
        if topic.name == "/effort_controller/commands":
            waiting.append(at)
        elif topic.name.endswith("/recording/cycle"):
            cycles.append((at, waiting))
            waiting = []
    sent = [at for at, came in cycles for _ in came]
    assert [came for _, came in cycles if came] == [[at] for at in sent]
    assert len(sent) == len(run.bench.efforts()) - 1
    assert waiting == [cycles[-1][0]]


def test_waiting_messages_are_limited_and_markers_recorded_without_subscription(robot_of, tmp_path):
    settings, _ = robot_of("go2")
    with recording(settings.model_copy(deep=True), None) as recorder:
        channel = recorder.channel("/a", "std_msgs/msg/String")
        for keep in (recorder.record_outgoing, recorder.record_incoming):
            for _ in range(25_000):
                keep(channel, b"x")
            assert 0 < len(recorder._messages) <= 20_000
            recorder._messages.clear()
    settings, _ = robot_of("g1")
    (markers,) = (topic for topic in endpoints(CONTROLLER_TOPICS, "controller") if topic.key == "markers")
    for file, expected in ((tmp_path / "a.mcap", True), (None, False)):
        with recording(settings.model_copy(deep=True), file) as recorder:
            tapped = RecordingTransport(MemoryTransport(MemoryBus()), recorder)
            tapped.advertise(markers)
            assert tapped.has_reader(markers) == expected


def test_a_fault_leaves_the_last_seconds_with_its_sentence(record, tmp_path):
    run = record(changes={"recorder": {"folder": str(tmp_path / "faults"), "seconds": 5.0}})
    run.stand(60)
    run.bench.v[0] = 1e4  # no base is as fast
    run.go(5)
    found = run.finish()
    assert found.path.match("go2-*IMPLAUSIBLE_STATE.mcap")
    ((cycle, fault),) = found.faults.items()
    assert fault == run.bench.reports[-1].fault
    assert cycle == next(i for i, each in enumerate(run.bench.reports) if each.fault is not None)
    assert found.last >= cycle


@pytest.mark.parametrize("after", [0, 1, 7])  # a batch has eight cycles
def test_events_of_the_last_cycles_are_recorded(record, tmp_path, after):
    run = record(tmp_path / "a.mcap")
    run.stand(20)
    run.bench.command("estop")
    run.go(1 + after)
    (fault,) = run.finish().faults.values()
    assert fault.code == "ESTOP"


@pytest.mark.parametrize("what", ["request", "fault"])
def test_a_request_to_a_slow_recorder_is_written_later(record, tmp_path, what):
    run = record(changes={"recorder": {"folder": str(tmp_path / "faults"), "seconds": 5.0}})
    run.stand(20)
    send, run.recorder._process.send = run.recorder._process.send, lambda batch: False
    if what == "request":
        run.recorder.request("LATER")
    else:
        run.bench.v[0] = 1e4  # no base is as fast
    run.go(10)
    assert "cycles were dropped" in run.recorder.status()["recorder"]
    run.recorder._process.send = send
    run.go(10)
    assert run.finish().path.match("*LATER.mcap" if what == "request" else "*IMPLAUSIBLE_STATE.mcap")


def test_a_request_leaves_the_last_seconds_and_the_oldest_files_go(record, tmp_path, make, caplog):
    folder = tmp_path / "faults"
    folder.mkdir()
    for i in range(4):
        old = folder / f"go2-20200101-00000{i}-OLD.mcap"
        old.write_bytes(b"")
        os.utime(old, (i, i))
    other = folder / "mine.mcap"
    other.write_bytes(b"")
    run = record(changes={"recorder": {"folder": str(folder), "files": 3}})
    run.stand(20)
    assert run.recorder.status() == {"recorder": "the last 10 s are kept", "recorder_said": "0"}
    run.bench.send("record", make.string("look / here"))
    run.go(5)
    run.bench.send("record", make.string("and here"))
    run.go(5)
    run.recorder.close()
    (path,) = folder.glob("*look-here.mcap")
    assert Recording(path).count == 33
    assert [said.split(repr(str(path))) for said in caplog.messages if repr(str(path)) in said] == [
        ["the last seconds are written to ", " (look / here)"],
        ["the last seconds are already in ", ", now continued (and here)"],
    ]
    assert run.recorder.status()["recorder_said"] == "2"
    kept = sorted(each.name for each in folder.glob("*OLD*"))
    assert kept == ["go2-20200101-000002-OLD.mcap", "go2-20200101-000003-OLD.mcap"]
    assert other.exists()


def test_the_last_seconds_are_bounded(record, tmp_path):
    folder = tmp_path / "faults"
    run = record(changes={"recorder": {"folder": str(folder), "seconds": 0.5}, "control": {"diagnostics_rate": 1.0}})
    run.stand(1500)
    run.recorder.request("now")
    run.go(2)
    found = run.finish()
    assert found.last == 1504
    assert found.count < 1100  # half a second, and other messages in the same chunk of 1 MB


@pytest.mark.parametrize(
    ("name", "reason"),
    [("missing/a.mcap", "No such file"), (".", "Is a directory"), ("/dev/full", "No space"), ("x" * 300, "too long")],
)
def test_a_failed_disk_is_a_warning(record, tmp_path, caplog, name, reason):
    run = record(tmp_path / name)
    run.stand()
    run.recorder.close()
    assert run.bench.reports[-1].mode.value == "active"
    (warning,) = [each.getMessage() for each in caplog.records if "cannot be written" in each.getMessage()]
    assert warning.startswith(f"the recording '{tmp_path / name}' cannot be written: ")
    assert reason in warning


def test_a_killed_recorder_is_a_warning(record, tmp_path, caplog):
    run = record(tmp_path / "a.mcap")
    run.stand()
    process = run.recorder._process._process
    process.kill()
    process.wait()
    run.go(40)
    assert run.bench.reports[-1].mode.value == "active"
    assert sum("nothing is recorded any more" in each.getMessage() for each in caplog.records) == 1


def test_a_defect_of_the_recorder_ends_the_recording_alone(record, tmp_path, caplog):
    run = record(tmp_path / "a.mcap")
    run.recorder._snapshot_due = None
    run.stand(40)
    assert (run.bench.reports[-1].mode.value, run.bench.loop.controller.cycle_records) == ("active", None)
    assert sum("the recorder failed" in each.getMessage() for each in caplog.records) == 1


def test_a_pipe_that_is_full_loses_cycles_and_never_waits(bench, tmp_path, caplog):
    made = bench("go2", {"recorder": {"folder": str(tmp_path)}}, lambda s: Recorder(s, tmp_path / "a.mcap", name="go2"))
    process = made.recorder._process._process
    os.kill(process.pid, signal.SIGSTOP)
    made.cycle(600)
    assert any("the recorder is too slow" in each.getMessage() for each in caplog.records)
    os.kill(process.pid, signal.SIGCONT)
    deadline = time.monotonic() + 20.0
    while made.recorder._dropped_cycles and time.monotonic() < deadline:
        made.cycle(8)
        time.sleep(0.02)
    made.cycle(50)
    made.recorder.close()
    found = Recording(tmp_path / "a.mcap")
    assert 0 < found.count < found.last + 1
    assert found.memory_after(found.last - 49) is not None  # a memory follows the gap


def test_messages_that_are_turned_away_for_their_size_are_not_recorded(record, tmp_path):
    run = record(tmp_path / "a.mcap")
    for _ in range(20):
        run.bench.send_bytes("update", bytes((1 << 20) + 1))
        run.go(1)
    found = run.finish()
    assert found.count == found.last + 1  # without a cycle
    assert (tmp_path / "a.mcap").stat().st_size < 1 << 20


def test_messages_of_a_flooded_topic_are_dropped_and_counted(record, tmp_path, make):
    run = record(tmp_path / "a.mcap")
    run.stand(10)
    nonsense = encode(make.string("{tasks: {com: {stiffness: [" + "1, " * 400 + "]}}}"))
    large = encode(make.string("x" * 500_000))
    for _ in range(8):
        for _ in range(50):
            run.bench.send_bytes("update", nonsense)
        for _ in range(3):  # above the limit of eight cycles
            run.bench.send_bytes("trajectory", large, "com")
        run.go(1)
    run.bench.send_bytes("setpoint", large, "com")  # a single message is recorded
    run.go(20)
    found = run.finish()
    assert found.count == found.last + 1
    counts = {topic.name: found.counts.get(number, 0) for number, topic in found.topics.items()}
    (update,) = [topic for topic in counts if topic.endswith("/update")]
    left_out = sum(event.get("left out", {}).get(update, 0) for event in found.events.values())
    assert counts[update] + left_out == 400
    assert counts[update] * len(nonsense) < 2 * (66 << 10)  # in one or two batches of eight cycles
    assert counts["/joint_states"] == counts["/odom"] == found.count
    assert [count for topic, count in counts.items() if topic.endswith("/tasks/com/setpoint")] == [1]
    assert f"messages on {update}" in summarize(found)


@pytest.mark.parametrize("whom", ["controller", "both"])
def test_a_file_is_readable_after_a_kill(tmp_path, whom):
    path, counter = tmp_path / "a.mcap", tmp_path / "count"
    counter.write_bytes(bytes(8))
    process = subprocess.Popen([sys.executable, str(SCRIPT), str(path), str(counter)])
    until(lambda: struct.unpack("<q", counter.read_bytes())[0] >= 300, "300 cycles", patience=60.0)
    time.sleep(np.random.default_rng().uniform(0.0, 0.3))
    writers = [int(each) for each in Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()]
    if whom == "both":
        for each in writers:
            os.kill(each, signal.SIGKILL)
    process.kill()
    process.wait()
    (last,) = struct.unpack("<q", counter.read_bytes())
    until(lambda: all(map(has_ended, writers)), "the writers to end")
    found = Recording(path)
    assert found.last >= last - 1 - (500 if whom == "both" else 20)
    assert len(by_rosbags(path)) == sum(found.counts.values())
    if whom == "controller":  # on a busy computer its end may fall into the recording of an earlier fault
        kept = [Recording(each).last for each in (tmp_path / "faults").glob("go2-*.mcap")]
        assert max(kept) >= last - 1 - 20
