"""The record of a run: bounded in memory, readable, and one sentence where it cannot be written."""

from __future__ import annotations

import resource
import subprocess
import sys
import tracemalloc
from types import SimpleNamespace

import numpy as np
import pytest

from wbc_controller.diagnostics.recorder import CycleRecorder, recording
from wbc_controller.errors import WbcError
from wbc_controller.records import Mode


def cycle(
    i: int, *, size: int = 30, mode: Mode = Mode.ACTIVE, audit: object = None, **stages: float
) -> SimpleNamespace:
    command = SimpleNamespace(stamp=i, tau=np.full(size, float(i)))
    state = SimpleNamespace(q=np.full(size + 7, float(i)), v=np.full(size + 6, float(i)))
    solution = SimpleNamespace(forces={"foot": np.full(6, float(i))}) if i % 2 else None
    return SimpleNamespace(
        command=command, mode=mode, stage_seconds={"total": 0.001, **stages}, audit=audit, state=state,
        solution=solution,
    )  # fmt: skip


def read(path):
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files if name != "allow_pickle"}


@pytest.mark.parametrize("count", [1, 9, 10, 11, 25])
def test_the_last_cycles_are_kept_in_their_order(tmp_path, count):
    recorder = CycleRecorder(10)
    for i in range(count):
        recorder.add(cycle(i, mode=Mode.DAMPING if i % 2 else Mode.ACTIVE))
    recorder.save(tmp_path / "cycles.npz")
    content = read(tmp_path / "cycles.npz")
    kept = list(range(max(0, count - 10), count))
    assert content["stamp"].tolist() == kept
    assert content["tau"].shape == (len(kept), 30)
    assert content["tau"][:, 3].tolist() == kept
    assert content["q"][:, 36].tolist() == content["v"][:, 35].tolist() == kept
    if count > 1:  # without a solution there is no force
        np.testing.assert_array_equal(content["force/foot"][:, 5], [i if i % 2 else np.nan for i in kept])
    assert content["mode"].tolist() == ["damping" if i % 2 else "active" for i in kept]
    assert content["seconds/total"].tolist() == [0.001] * len(kept)
    assert np.isnan(content["audit"][:, :4]).all()
    assert not content["audit"][:, 4].any()


def test_a_stage_that_is_not_in_every_cycle_is_nan_in_the_others(tmp_path):
    recorder = CycleRecorder(4)
    for i in range(6):
        recorder.add(cycle(i, **({"solve": 0.5} if i in (2, 4) else {})))
    recorder.save(tmp_path / "cycles.npz")
    np.testing.assert_array_equal(read(tmp_path / "cycles.npz")["seconds/solve"], [0.5, np.nan, 0.5, np.nan])


def test_memory_does_not_grow_with_the_run():
    recorder = CycleRecorder(500)
    tracemalloc.start()
    try:
        for i in range(1000):
            recorder.add(cycle(i))
        before, _ = tracemalloc.get_traced_memory()
        for i in range(5000):
            recorder.add(cycle(i))
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 10_000


def test_without_a_file_nobody_observes():
    with recording(None) as observers:
        assert observers == ()


def test_a_run_without_a_command_leaves_no_file_and_one_that_was_there_stays(tmp_path):
    path = tmp_path / "cycles.npz"
    with recording(path) as (observe,):
        observe(SimpleNamespace(command=None))
    assert not path.exists()
    path.write_text("older")
    with recording(path) as (observe,):
        observe(SimpleNamespace(command=None))
    assert path.read_text() == "older"


def test_what_has_no_suffix_is_written_under_its_own_name(tmp_path):
    with recording(tmp_path / "cycles") as (observe,):
        observe(cycle(7))
    assert read(tmp_path / "cycles")["stamp"].tolist() == [7]


@pytest.mark.parametrize("name", ["missing/cycles.npz", ".", "x" * 300 + ".npz"])
def test_a_file_that_cannot_be_written_is_refused_before_the_run(tmp_path, name):
    with pytest.raises(WbcError, match=r"^the record '.*' cannot be written: "), recording(tmp_path / name):
        pytest.fail("the run began")


@pytest.mark.parametrize("room", [100, 5000, 40_000])
def test_a_full_disk_at_the_end_is_one_sentence_and_leaves_no_half_file(tmp_path, room):
    path = tmp_path / "cycles.npz"
    recorder = CycleRecorder(2000)
    rng = np.random.default_rng(0)
    for i in range(2000):
        row = cycle(i)
        row.command.tau[:] = rng.normal(size=30)
        recorder.add(row)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, limits[1]))
    try:
        with pytest.raises(WbcError, match=r"^the record '.*cycles.npz' cannot be written: File too large$"):
            recorder.save(path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not path.exists()


@pytest.mark.live
def test_the_command_says_at_its_start_that_it_cannot_record(tmp_path):
    ended = subprocess.run(
        [sys.executable, "-m", "wbc_controller", "run", "go2", "--record", str(tmp_path / "missing" / "cycles.npz")],
        capture_output=True, text=True, timeout=30,
    )  # fmt: skip
    assert ended.returncode == 2
    assert ended.stderr == (
        f"error: the record '{tmp_path}/missing/cycles.npz' cannot be written: No such file or directory\n"
    )
