"""Keeps what the cycles did, for a file at the end: torques, modes and times."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from wbc_controller.records import CycleReport


class CycleRecorder:
    """Collects the torques and times of every cycle that sent a command."""

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._tau: list[np.ndarray] = []
        self._modes: list[str] = []
        self._seconds: list[dict[str, float]] = []

    def add(self, report: CycleReport) -> None:
        """Take one report."""
        if report.command is None:
            return
        self._stamps.append(report.command.stamp)
        self._tau.append(report.command.tau)
        self._modes.append(report.mode.value)
        seconds = dict(report.stage_seconds)
        self._seconds.append(seconds)

    def save(self, path: Path) -> None:
        """Write an .npz file: stamp (n,) ns, tau (n, na) N·m, mode (n,), and seconds/<stage> (n,) s."""
        stages = sorted({stage for seconds in self._seconds for stage in seconds})
        times = {
            f"seconds/{stage}": np.array([seconds.get(stage, np.nan) for seconds in self._seconds]) for stage in stages
        }
        np.savez_compressed(
            path,
            stamp=np.array(self._stamps, dtype=np.int64),
            tau=np.array(self._tau),
            mode=np.array(self._modes, dtype=np.str_),
            allow_pickle=False,
            **times,
        )
