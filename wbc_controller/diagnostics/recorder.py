"""Records torques, modes, times and audits of the cycles, and saves them to a file at the end."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from wbc_controller.records import CycleReport

#: Columns of ``audit``.
AUDIT_COLUMNS = ("energy", "throughput", "force", "torque", "warnings")


class CycleRecorder:
    """Collects the torques, times and audits of every cycle that sent a command."""

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._tau: list[np.ndarray] = []
        self._modes: list[str] = []
        self._seconds: list[dict[str, float]] = []
        self._audits: list[tuple[float, float, float, float, int]] = []

    def add(self, report: CycleReport) -> None:
        """Add the report of a cycle."""
        if report.command is None:
            return
        self._stamps.append(report.command.stamp)
        self._tau.append(report.command.tau)
        self._modes.append(report.mode.value)
        self._seconds.append(dict(report.stage_seconds))
        audit = report.audit
        self._audits.append(
            (np.nan, np.nan, np.nan, np.nan, 0)
            if audit is None
            else (
                audit.energy,
                audit.throughput,
                float(np.linalg.norm(audit.force)),
                float(np.max(np.abs(audit.joint_torques))),
                len(audit.warnings),
            )
        )

    def save(self, path: Path) -> None:
        """Write an .npz file.

        It holds stamp (n,) in ns, tau (n, na) in N·m, mode (n,), seconds/<stage> (n,) in s, and audit (n, 5) with the
        columns of `AUDIT_COLUMNS`: energy residual and throughput in W, unexplained force in N, largest unexplained
        joint torque in N·m, and the number of warnings. Without an audit the residuals are NaN.
        """
        stages = sorted({stage for seconds in self._seconds for stage in seconds})
        times = {
            f"seconds/{stage}": np.array([seconds.get(stage, np.nan) for seconds in self._seconds]) for stage in stages
        }
        np.savez_compressed(
            path,
            stamp=np.array(self._stamps, dtype=np.int64),
            tau=np.array(self._tau),
            mode=np.array(self._modes, dtype=np.str_),
            audit=np.array(self._audits),
            allow_pickle=False,
            **times,
        )
