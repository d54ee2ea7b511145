"""A controller on a bench whose cycles are recorded."""

import shutil
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2.storage_mcap import McapReader

from wbc_controller.recording.recorder import Recorder
from wbc_controller.recording.recording_file import Recording


class Run:
    """A recorded controller, whose robot moves a little; `file` is None for recordings of faults only."""

    def __init__(self, bench: Any, file: Path | None) -> None:
        self.bench = bench
        self.file = file
        self.recorder = bench.recorder
        self._rng = np.random.default_rng(1)

    def go(self, cycles: int, **without: bool) -> None:
        model = self.bench.model
        for _ in range(cycles):
            speed = 0.02 * self._rng.normal(size=model.nj)
            self.bench.v[model.v_index] = speed
            self.bench.q[model.q_index] += speed * self.bench.period
            self.bench.cycle(**without)

    def stand(self, cycles: int = 40) -> None:
        self.go(3)
        self.bench.command("activate")
        self.go(cycles)

    def finish(self) -> Recording:
        """End the recorder, and read its file: that of the run, or the only one of a fault."""
        self.recorder.close()
        if self.file is None:
            (self.file,) = Path(self.bench.settings.recorder.folder).iterdir()
        return Recording(self.file)


def make_run(
    bench: Callable[..., Any],
    folder: Path,
    file: Path | None,
    changes: dict[str, Any] | None = None,
    robot: str = "go2",
) -> Run:
    """Make a recorded controller; recordings of faults go into the folder."""
    settings = {"safety": {"activation_ramp": 0.01}, "recorder": {"folder": str(folder / "faults")}}
    recorder = partial(Recorder, file=file, patient=True, name="go2")
    run = Run(bench(robot, {**settings, **(changes or {})}, recorder), file)
    run.bench.q = run.bench.q.copy()
    return run


def by_rosbags(path: Path) -> list[tuple[str, int, bytes]]:
    """Return topic, time and content of the messages of a file, read by rosbags."""
    reader = McapReader(path)
    reader.open()
    found = [(connection.topic, time, bytes(data)) for connection, time, data in reader.messages(reader.connections)]
    reader.close()
    return found


def copied(path: Path, folder: Path) -> Recording:
    """Return a recording in a copy of its file."""
    return Recording(Path(shutil.copy(path, folder)))


@pytest.fixture
def record(bench: Callable[..., Any], tmp_path: Path) -> Iterator[Callable[..., Run]]:
    """Makes a recorded controller; its process is ended with the test."""
    made: list[Run] = []

    def make(file: Path | None = None, changes: dict[str, Any] | None = None, robot: str = "go2") -> Run:
        made.append(make_run(bench, tmp_path, file, changes, robot))
        return made[-1]

    yield make
    for run in made:
        run.recorder.close()
